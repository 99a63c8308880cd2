"""Draw the axes of a head, and which way its angles are positive.

python examples/axes_of_a_head.py --out axes.png
"""

import argparse

import matplotlib
import numpy as np
from matplotlib import pyplot as plt

# Drawn as seen from behind and above: x right, y up, z towards the viewer (back).
AXES = {  # with the place of the name beside the tip
    "x: right\npitch, + looks up": ((1.0, 0.0, 0.0), (0.4, 0.0)),
    "y: up\nyaw, + turns left": ((0.0, 1.0, 0.0), (0.0, 0.14)),
    "z: back\nroll, + tilts to the left": ((0.0, 0.0, 1.0), (-0.1, -0.3)),
}
TURN_RADIUS = 0.28


def on_paper(point: np.ndarray) -> np.ndarray:
    """Project points of the head frame, shape (..., 3), to the drawing, (..., 2)."""
    x, y, z = np.moveaxis(np.asarray(point, float), -1, 0)
    return np.stack([x - 0.5 * z, y - 0.35 * z], axis=-1)


def turn(axis: np.ndarray) -> np.ndarray:
    """Arc of three quarters of a turn about an axis, right-handed, near its tip."""
    first = np.roll(axis, 1)
    second = np.cross(axis, first)
    angle = np.linspace(0, 1.5 * np.pi, 60)[:, None]
    return 0.72 * axis + TURN_RADIUS * (np.cos(angle) * first + np.sin(angle) * second)


def main() -> None:
    """Draw the head, its axes and its turns."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="axes.png")
    options = parser.parse_args()
    figure, paper = plt.subplots(figsize=(6, 5), layout="constrained")
    around = np.linspace(0, 2 * np.pi, 200)
    paper.fill(0.36 * np.cos(around), 0.44 * np.sin(around), color="0.88", zorder=0)
    for colour, (name, (axis, beside)) in zip(
        ("C3", "C2", "C0"), AXES.items(), strict=True
    ):
        axis = np.array(axis)
        tip = on_paper(1.15 * axis)
        arrow = {"arrowstyle": "-|>", "color": colour, "lw": 2.5}
        paper.annotate("", tuple(tip), (0, 0), arrowprops=arrow)
        arc = on_paper(turn(axis))
        paper.plot(*arc.T, color=colour, lw=1.2)
        paper.annotate(
            "",
            tuple(arc[-1]),
            tuple(arc[-4]),
            arrowprops={"arrowstyle": "-|>", "color": colour},
        )
        paper.annotate(
            name, tuple(tip + beside), ha="center", va="center", color=colour
        )
    gaze = {"arrowstyle": "-|>", "color": "0.4", "ls": "--"}
    ahead = tuple(on_paper(np.array([0, 0, -1.2])))
    paper.annotate("", ahead, (0, 0), arrowprops=gaze)
    label = tuple(on_paper(np.array([0, 0, -1.45])))
    paper.annotate("gaze: along -z", label, color="0.4", ha="center", va="bottom")
    paper.set(xlim=(-1.3, 1.75), ylim=(-0.95, 1.6), aspect="equal")
    paper.axis("off")
    figure.savefig(options.out, dpi=110)


if __name__ == "__main__":
    matplotlib.use("Agg")
    main()
