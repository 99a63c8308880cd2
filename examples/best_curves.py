"""How the best blending curve depends on refresh rate and on the head.

For each, Kim et al.'s constants are fitted anew: as little flicker as possible at the
detail loss of their own. Prints a table of the best numbers with 95 % intervals, and of
how much less the family flickers at equal detail loss on held-out sessions.

    python examples/best_curves.py --scenes coffee text --sessions 32 --heads seated
"""

import argparse
import sys

import jax
import numpy as np

import hmdjit as hj
from hmdjit.curve_fitting import CurveFit, CurveSpace, NoFitError, fit
from hmdjit.reports import curve_fitting as report
from hmdjit.studies.measured_blocks import Tiles

SCENES = ("coffee", "grass", "rocket", "text")
HEADS = ("fixating", "seated", "free_viewing", "tracker_noise")
RATES_HZ = (60.0, 72.0, 90.0, 120.0)


def best(
    head: str, refresh_hz: float, scenes: list[str], sessions: int, width_px: int
) -> CurveFit:
    """Fit a curve for a head and a refresh rate; the field of view shrinks with px."""
    known = hj.scenes.study_set()
    px_per_tan = 1024 / 2 / np.tan(np.radians(96 / 2))  # of the default camera
    fov_deg = 2 * np.degrees(np.arctan(width_px / 2 / px_per_tan))
    study = hj.Study(
        scenes={name: known[name] for name in scenes},
        techniques=[hj.techniques.HeadMovement()],
        baseline="head_movement",
        head=hj.HeadMotion.preset(head),
        camera=hj.Camera(width_px, width_px, float(fov_deg), refresh_hz),
        measure=Tiles(1, 32),
        sessions=sessions,
    )
    about = f"{head}, {refresh_hz:g} Hz"
    tell = lambda event: print(f"{about}: {event.doing}", file=sys.stderr)
    return fit(study, CurveSpace(), progress=tell)


def short(number: float) -> str:
    """Two digits, or all of a large number's."""
    return f"{number:.0f}" if abs(number) >= 10 else f"{number:.2g}"


def row(name: str, found: CurveFit) -> str:
    """Lay a fit out as a row of the table."""
    sure = zip(found.numbers, found.errors.low, found.errors.high, strict=True)
    cells = ["{} [{}, {}]".format(*map(short, numbers)) for numbers in sure]
    gain = report.gain_percent(found)
    cells.append(
        "not known"
        if gain is None
        else f"{gain.value:.1f} [{gain.low:.1f}, {gain.high:.1f}]"
    )
    return f"| {name} | {' | '.join(cells)} |"


def main() -> None:
    """Fit them all, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--heads", nargs="+", default=HEADS)
    parser.add_argument("--rates", nargs="+", type=float, default=RATES_HZ)
    parser.add_argument("--sessions", type=int, default=32)
    parser.add_argument("--width", type=int, default=1024)
    options = parser.parse_args()
    jax.config.update("jax_num_cpu_devices", 2)
    cases = dict.fromkeys(
        [(options.heads[0], rate) for rate in options.rates]
        + [(head, options.rates[0]) for head in options.heads]
    )
    print("| head | w_min | w_lb | h_max, deg/s | d | less flicker, % |")
    print("|---|---|---|---|---|---|", flush=True)
    for head, rate in cases:
        name = f"{head}, {rate:g} Hz"
        try:
            found = best(head, rate, options.scenes, options.sessions, options.width)
        except NoFitError as error:
            print(f"| {name} | {error} |", flush=True)
        else:
            print(row(name, found), flush=True)


if __name__ == "__main__":
    main()
