"""What would change head movement's ratio most? Its derivative in every parameter.

By reverse mode, with 95 % intervals over sessions. The page has the numbers of camera
and technique whose sign is sure, the CSV beside it all of them. Writes
`sensitivities.md`.

    python examples/sensitivities.py --scenes coffee text --sessions 64
"""

import sys

import jax
import pages

import hmdjit as hj
from hmdjit.sensitivity import sensitivity
from hmdjit.studies.progress import Progress


def tell(event: Progress) -> None:
    """Say on stderr what is done."""
    print(f"{event.done}/{event.total} {event.doing}", file=sys.stderr, flush=True)


def main() -> None:
    """Measure, and write the page and the CSV."""
    parser = pages.arguments(__file__, __doc__)
    parser.add_argument("--scenes", nargs="+", default=["coffee", "text"])
    parser.add_argument("--sessions", type=int, default=64)
    parser.add_argument("--head", default="seated")
    options = parser.parse_args()
    jax.config.update("jax_num_cpu_devices", 2)
    known = hj.scenes.study_set()
    found = sensitivity.sensitivities(
        {name: known[name] for name in options.scenes},
        hj.Camera(),
        hj.techniques.HeadMovement(),
        hj.HeadMotion.preset(options.head),
        sessions=options.sessions,
        progress=tell,
    )
    sensitivity.write_csv(found, options.out.with_suffix(".csv"))
    sure = [
        row
        for row in found.rows()
        if row.name.startswith(("camera.", "technique.")) and row.sign in ("+", "-")
    ]
    sure.sort(key=lambda row: -abs(row.derivative))
    rows = [
        (row.name, f"{row.derivative:+.3f}", f"[{row.low:+.3f}, {row.high:+.3f}]")
        for row in sure
    ]
    ratio = found.ratio
    blocks = {
        "ratio": f"R = {ratio.value:.3f} [{ratio.low:.3f}, {ratio.high:.3f}]",
        "numbers": pages.table(("number p", "d ln R / d ln p", "95 %"), rows),
    }
    pages.write(__file__, blocks, options.out)


if __name__ == "__main__":
    main()
