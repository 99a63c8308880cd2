"""What would change head movement's ratio most? Its derivative in every parameter.

By reverse mode, with 95 % intervals over sessions; bold where the sign is sure.

    python examples/sensitivities.py --scenes coffee text --sessions 256
"""

import argparse
import sys

import jax
import rich.console

import hmdjit as hj
from hmdjit.reports import sensitivity as sensitivity_report
from hmdjit.sensitivity import sensitivity
from hmdjit.studies.progress import Progress


def tell(event: Progress) -> None:
    """Say on stderr what is done."""
    print(f"{event.done}/{event.total} {event.doing}", file=sys.stderr, flush=True)


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=["coffee", "text"])
    parser.add_argument("--sessions", type=int, default=64)
    parser.add_argument("--head", default="seated")
    parser.add_argument("--out", help="CSV")
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
    if options.out:
        sensitivity.write_csv(found, options.out)
    console = rich.console.Console(width=100)
    console.print(sensitivity_report.table(found))
    console.print(sensitivity_report.explanation(found), markup=False)


if __name__ == "__main__":
    main()
