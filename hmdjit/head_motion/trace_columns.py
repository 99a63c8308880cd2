"""Names of a head trace's columns: which hold times, which a pose, in what.

What could mean two things is refused, naming the option that decides it.
"""

import re
from collections.abc import Sequence

UNITS = {  # parts of a second; names
    "s": (1, {"s", "sec", "second", "seconds"}),
    "ms": (10**3, {"ms", "msec", "millis", "milliseconds"}),
    "us": (10**6, {"us", "usec", "micros", "microseconds"}),
    "ns": (10**9, {"ns", "nsec", "nanos", "nanoseconds"}),
}
# Names as `plain` writes them: `Time [s]` is time_s, `HMD.qW` is hmd_q_w. An
# orientation's first group tells one from another: hmd_q, rot, "" for bare w, x, y, z.
_TIMES = {"t", "ts", "time", "timestamp", "time_stamp", "xr_time", "xrtime"}
_TIMES |= {"display_time", "predicted_display_time"}
_ROTATION = "q|quat|quaternion|rot|rotation|orientation"
_XYZW = re.compile(rf"(.*_)?({_ROTATION})")
_ORIENTATIONS = {
    ("qw", "qx", "qy", "qz"): rf"((?:.*_)?(?:{_ROTATION})?_?)([wxyz])()",
    (
        "pitch",
        "yaw",
        "roll",
    ): r"((?:.*_)?)(pitch|yaw|roll)(_deg(?:rees)?|_rad(?:ians)?)?",
}
# A position stands beside its orientation: `hmd_pos_x` by `hmd_qw`.
_POSITION = "p|pos|position|translation|location|t"
_XYZ = re.compile(rf"(.*_)?({_POSITION})")
_POINT = rf"({_POSITION})?_?([xyz])(?:_(m|cm|mm|(?:centi|milli)?met(?:er|re)s?))?"
_BESIDE = rf"((?:.*?_)??)(?:{_ROTATION})?_?(?:[wxyz]|pitch.*|yaw.*|roll.*)"
# Points and vectors of WebXR have a fourth number, too.
_PLACES = r"(.*_)?(p|pos|position|translation|location|scale|velocity|acceleration)_?"
_MATRIX = re.compile(r"(.*_)?(matrix|m[0-3][0-3]|r[1-3][1-3])(_\d+)*")


def used(names: Sequence[str], where: str) -> list[int]:
    """Find the columns of time, orientation (`wxyz`, or pitch, yaw, roll), position.

    Three of a position are there only where one stands beside the orientation.
    """
    times = [i for i, name in enumerate(names) if unit_in(name) is not None]
    groups: dict[tuple[str, ...], dict[str, list[int]]] = {}
    for i, name in enumerate(names):
        for parts, pattern in _ORIENTATIONS.items():
            match = re.fullmatch(pattern, plain(name))
            if match and not re.fullmatch(_PLACES, match[1]):
                kind = f"{match[1].rstrip('_')} {match[3] or ''}"
                part = next(part for part in parts if part.endswith(match[2]))
                group = groups.setdefault((kind, *parts), {})
                group.setdefault(part, []).append(i)
    # What lacks a part is something else, such as a position's x, y and z.
    full = [group for group in groups if len(groups[group]) == len(group) - 1]
    whole = [[groups[group][part] for part in group[1:]] for group in full]
    header = f"the header is {shown(','.join(names))}"
    if not times or not whole:
        nearest = max(groups, key=lambda group: len(groups[group]), default=("", "qw"))
        lacks = [part for part in nearest[1:] if part not in groups.get(nearest, ())]
        column = lacks[0] if times else "t_s"
        if times and any(_MATRIX.fullmatch(plain(name)) for name in names):
            header += "; matrices are not read: write unit quaternions"
        raise ValueError(f"{where}, column {column}: is missing; {header}.")
    found = [part[0] for part in whole[0]]
    points = _points(names, found)
    point = points[0] if points else []
    sets = [[group[0][0] for group in each] for each in (whole, points) if each]
    for rivals in (times, *whole[0], *point, *sets):
        one, other = names[rivals[0]], names[rivals[-1]]
        if one == other and len(rivals) > 1:
            raise ValueError(f"{where}, column {one}: appears twice; {header}.")
        if one != other:
            both = f"columns {one} and {other}: either could be meant"
            raise ValueError(f"{where}, {both}; choose by the option columns.")
    return [times[0], *found, *(part[0] for part in point)]


def _points(names: Sequence[str], taken: Sequence[int]) -> list[list[list[int]]]:
    """Columns of x, y and z of the positions beside an orientation's columns."""
    beside = re.fullmatch(_BESIDE, plain(names[taken[0]]))
    prefix = re.escape(beside[1] if beside else "")
    groups: dict[tuple[str, str], dict[str, list[int]]] = {}
    for i, name in enumerate(names):
        match = re.fullmatch(prefix + _POINT, plain(name))
        if match and i not in taken:
            group = groups.setdefault((match[1] or "", match[3] or ""), {})
            group.setdefault(match[2], []).append(i)
    whole = [group for group in groups.values() if len(group) == 3]
    return [[group[axis] for axis in "xyz"] for group in whole]


def parts_of_metre(name: str) -> int | None:
    """Read how many make a metre in a position column's name; None if it is silent."""
    unit = re.fullmatch(rf".*?{_POINT}", plain(name))
    if unit is None or unit[3] is None:
        return None
    return 1000 if unit[3][:2] in ("mm", "mi") else 100 if unit[3][0] == "c" else 1


def plain(name: str) -> str:
    """Lower case, with one `_` between words, whatever stood there."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name.replace("µ", "u"))
    return re.sub(r"[^a-z0-9]+", "_", words.lower()).strip("_")


def unit_in(name: str) -> str | None:
    """Read the unit in a time column's name, "" if it has none; None for others."""
    last_part = plain(name.rpartition(".")[2])
    word, _, last = last_part.rpartition("_")
    for unit, (_, names) in UNITS.items():
        if last in names and (not word or word in _TIMES):
            return unit
    return "" if last_part in _TIMES else None


def is_xyzw(name: str) -> bool:
    """Whether a list of four numbers of this name is a quaternion, its `w` last."""
    return _XYZW.fullmatch(plain(name)) is not None


def is_xyz(name: str) -> bool:
    """Whether a list of three numbers of this name is a position."""
    return _XYZ.fullmatch(plain(name)) is not None


def shown(text: str) -> str:
    """Quote a text, cut where it is long."""
    return repr(text if len(text) <= 60 else text[:57] + "...")
