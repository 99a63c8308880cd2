import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
QUICK = {
    "axes_of_a_head.py": (),
    "flicker_of_heads.py": ("--sessions", "4", "--scenes", "astronaut"),
    "ratio_against_correlation.py": ("--sessions", "4", "--crop", "16"),
}
PRINTING = {
    "quasi_random_paths.py": ("--scenes", "noise"),
    "sensitivities.py": ("--scenes", "noise", "--sessions", "4"),
    "time_to_one_percent.py": ("--scenes", "noise", "--sessions", "4"),
}
TABLES = {
    "best_curves.py": (
        *("--scenes", "checkerboard", "--sessions", "16", "--width", "64"),
        *("--heads", "fixating", "--rates", "60"),
    ),
}


def test_every_example_is_run():
    examples = {path.name for path in EXAMPLES.glob("*.py")}
    assert examples == set(QUICK) | set(PRINTING) | set(TABLES)


@pytest.mark.slow
@pytest.mark.parametrize("name", TABLES)
def test_examples_print_a_table_of_numbers_within_their_intervals(name):
    command = [sys.executable, str(EXAMPLES / name), *TABLES[name]]
    done = subprocess.run(
        command, check=True, capture_output=True, text=True, timeout=600
    )
    header, _, row = done.stdout.splitlines()
    head, *cells = (cell.strip() for cell in row.strip("|").split("|"))
    assert head == "fixating, 60 Hz"
    assert len(cells) == header.count("|") - 2
    for cell in cells[:-1]:
        best, low, high = (float(x.strip("[],")) for x in cell.split())
        assert low <= best <= high


@pytest.mark.slow
@pytest.mark.parametrize("name", PRINTING)
def test_examples_print_their_table(name):
    command = [sys.executable, str(EXAMPLES / name), *PRINTING[name]]
    done = subprocess.run(
        command, check=True, capture_output=True, text=True, timeout=600
    )
    if name == "sensitivities.py":
        # More weight on the current picture leaves more of its flicker.
        (row,) = (x for x in done.stdout.splitlines() if "technique.w_min" in x)
        assert row.split()[-1] == "+"
        return
    row = done.stdout.splitlines()[-1].split(", ")
    assert row[0] == "noise"
    if name == "time_to_one_percent.py":
        assert float(row[1]) > float(row[2]) > 0
    else:
        # A gain of 3 is below 1 in 48 replicates each with probability 1e-4.
        assert float(row[2].split()[0]) > 1


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_examples_write_their_picture(name, tmp_path):
    out = tmp_path / "picture.png"
    command = [sys.executable, str(EXAMPLES / name), *QUICK[name], "--out", str(out)]
    subprocess.run(command, check=True, cwd=EXAMPLES.parent, timeout=300)
    assert out.stat().st_size > 10_000
