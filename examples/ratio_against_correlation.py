"""Draw the map "MTCD ratio against velocity correlation".

When does the 56 % of Kim et al. come out?
The ratio MTCD(head movement) / MTCD(none) is not a constant of the method: it depends
on how correlated the head's velocity is from frame to frame, and on how many pixels a
frame's motion covers. The lines are simulated, the dashed one is the small-motion
theory.

    python examples/ratio_against_correlation.py --sessions 200 --out ratio.png
"""

import argparse

import matplotlib
import numpy as np
from matplotlib import pyplot as plt

import hmdjit as hj
from hmdjit.estimates.intervals import ratio_interval
from hmdjit.reproductions.kim_map import head_of
from hmdjit.studies.measured_blocks import CentralCrop

RATE_HZ, FRAMES, WARMUP = 60.0, 10, 12
W_MIN, D = 0.3, 2 / 3  # Kim et al.


def lag_one_correlation(model: hj.HeadMotion, axis: int = 0) -> float:
    """Correlation of one frame's rotation with the next one's; axis 0 is pitch."""
    lags = np.array([0, 1])
    now, later = np.asarray(model.increment_covariance(lags, RATE_HZ))[:, axis]
    return float(later / now)


def theory(model: hj.HeadMotion, axis: int = 0) -> float:
    """Small motions: displacement is filtered by (1 - d) + d A / (1 - (1 - A) / z)."""
    lags = np.arange(400)
    response = D * W_MIN * (1 - W_MIN) ** lags
    response[0] += 1 - D
    covariance = np.asarray(model.increment_covariance(lags, RATE_HZ))[:, axis]
    kernel = np.convolve(response, response[::-1])[len(lags) - 1 :]
    shown = kernel[0] * covariance[0] + 2 * kernel[1:] @ covariance[1:]
    return float(np.sqrt(shown / covariance[0]))


def main() -> None:
    """Simulate the map and draw it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--crop", type=int, default=64)
    parser.add_argument("--out", default="ratio_against_correlation.png")
    options = parser.parse_args()

    camera = hj.Camera(refresh_hz=RATE_HZ)
    px_per_deg = float(hj.camera.px_per_deg(camera, np.array([512.0, 512.0]))[0])
    correlations = (0.0, 0.3, 0.5, 0.8, 0.95)
    for preset in ("fixating", "seated"):
        known = hj.HeadMotion.preset(preset)
        turned_deg = float(known.increment_rms_deg(RATE_HZ))
        print(f"{preset} head: {turned_deg:.4f} deg per frame")
        for name, number in (("pitch", 0), ("yaw", 1)):
            correlation, ratio = (
                lag_one_correlation(known, number),
                theory(known, number),
            )
            print(f"  {name}: correlation {correlation:.3f}, theory {ratio:.3f}")
    figure, axis = plt.subplots(figsize=(7, 4.5), layout="constrained")
    for px_per_frame in (0.1, 0.3, 1.0):
        points = []
        for correlation in correlations:
            model = head_of(correlation, px_per_frame / px_per_deg, RATE_HZ)
            study = hj.Study(
                scenes={"noise": hj.scenes.power_law_noise()},
                techniques=[hj.techniques.by_id("none"), hj.techniques.HeadMovement()],
                head=model,
                camera=camera,
                sessions=options.sessions,
                frames=FRAMES,
                warmup=WARMUP,
                measure=CentralCrop(options.crop),
                baseline="none",
            )
            plain, blended = study.run(seed=0)["mtcd"].values[:, 0]
            ratio = ratio_interval(blended, plain)
            points.append(
                (lag_one_correlation(model), ratio.value, ratio.low, ratio.high)
            )
            print(
                f"{px_per_frame} px/frame, correlation {points[-1][0]:.3f}: "
                f"{ratio.value:.3f} [{ratio.low:.3f}, {ratio.high:.3f}]"
            )
        x, value, low, high = np.array(points).T
        error = (value - low, high - value)
        label = f"{px_per_frame:g} px per frame and axis"
        axis.errorbar(x, value, error, marker="o", capsize=3, label=label)
    lines = [head_of(c, 0.01, RATE_HZ) for c in np.linspace(0, 0.99, 40)]
    expected = [(lag_one_correlation(m), theory(m)) for m in lines]
    axis.plot(*np.array(expected).T, "k--", label="small-motion theory")
    axis.axhline(0.56, color="grey", linewidth=1)
    axis.annotate("Kim et al.: 0.56", (0.0, 0.567), color="grey")
    axis.set(
        xlabel="correlation of the head's velocity from frame to frame",
        ylabel="MTCD ratio, head movement / none",
        title=f"1/f noise, {options.sessions} sessions, 60 Hz, warm-up {WARMUP} frames",
    )
    axis.legend()
    figure.savefig(options.out, dpi=150)


if __name__ == "__main__":
    matplotlib.use("Agg")
    main()
