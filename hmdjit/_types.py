"""Shape names shared by the whole package.

Planes are `(channels, height, width)`: inside the simulator a picture is a stack of
planes, because the same step on `(height, width, 3)` costs 1.5 to 2.3 times as much.
The doors (`apply`, file readers) speak `(height, width, 3)`.
"""

from jaxtyping import Array, Bool, Float, Int, Key, Num

Scalar = Float[Array, ""] | float
"""A number: a Python float outside compiled code, a traced scalar inside."""

WholeNumber = Int[Array, ""] | int
"""A whole number: a Python int outside compiled code, a traced scalar inside."""

RandomKey = Key[Array, ""]
Quaternion = Float[Array, "4"]
"""Scalar first, `wxyz`."""

RotationVector = Float[Array, "3"]
"""Axis times angle, rad."""

Poses = Float[Array, "frames 4"] | Float[Array, "frames 7"]
"""`world_from_head`, `wxyz`; and where it is known the eye's position, m."""

Path = Float[Array, "frames 3"]
"""A rotation vector per frame, rad."""

Plane = Float[Array, "height width"]
Mask = Bool[Array, "height width"]
Planes = Float[Array, "channels height width"]
Rgb = Float[Array, "3 height width"]
Samples = Float[Array, "samples 3 height width"]
Picture = Float[Array, "height width 3"]
Clip = Float[Array, "frames height width 3"]
Numbers = Num[Array, "..."]
