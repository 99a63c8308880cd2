"""Gradient of flicker: how MTCD changes with each number of a technique, exactly.

`simulate` is differentiable from head, camera and technique to MTCD and detail loss.
One backward pass gives the slope by every number; a difference of two more simulations
says the same of one of them.

    python examples/gradient_of_flicker.py

printed

    MTCD 1.708 code values
    d MTCD / d w_min: 2.3 ± 0.5
    d MTCD / d w_lb: 0.045 ± 0.02
    d MTCD / d h_max_deg_s: -1.6e-05 ± 1e-05
    by w_min, first head: 1.895, by difference 1.896
"""

import argparse
import dataclasses

import jax
import numpy as np

import hmdjit as hj

NUMBERS = ("w_min", "w_lb", "h_max_deg_s")


def main() -> None:
    """Print slopes over a few heads, with their standard errors."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--heads", type=int, default=8)
    heads = parser.parse_args().heads
    camera = hj.Camera(width_px=96, height_px=96, fov_deg=12.0, refresh_hz=60.0)
    texture = hj.scenes.bake(hj.scenes.by_name("noise"), camera)
    head = hj.HeadMotion.fixating()
    kim = hj.techniques.HeadMovement()

    def mtcd(numbers: dict[str, float], key: jax.Array) -> jax.Array:
        technique = dataclasses.replace(kim, **numbers)
        poses = head.sample(key, 60.0, 22)
        return hj.simulate(texture, camera, technique, poses, warmup=12).mtcd

    start = {name: float(getattr(kim, name)) for name in NUMBERS}
    keys = jax.random.split(jax.random.key(0), heads)
    found = [jax.value_and_grad(mtcd)(start, key) for key in keys]
    print(f"MTCD {np.mean([value for value, _ in found]):.3f} code values")
    for name in NUMBERS:
        slopes = np.array([gradient[name] for _, gradient in found])
        error = slopes.std(ddof=1) / np.sqrt(heads)
        print(f"d MTCD / d {name}: {slopes.mean():.2g} ± {error:.1g}")
    step = 1e-2
    low, high = (start | {"w_min": start["w_min"] + s * step} for s in (-1, 1))
    slope = (mtcd(high, keys[0]) - mtcd(low, keys[0])) / (2 * step)
    print(
        f"by w_min, first head: {found[0][1]['w_min']:.3f}, by difference {slope:.3f}"
    )


if __name__ == "__main__":
    main()
