"""The command line's `hmdjit trade-off` and `hmdjit pick`."""

import dataclasses
import shlex
from pathlib import Path
from typing import Annotated, Any

import rich.console
import tyro

from .. import _checks, techniques
from .._files import check_can_write
from ..estimates.intervals import Z95
from ..figures import trade_off as trade_off_figure
from ..figures.drawing import save
from ..reports import trade_off as trade_off_report
from ..studies.identity import counted
from ..studies.study import Study
from ..trade_off import choice, knobs, measurement, settings, trade_off
from ..trade_off.choice import Choice
from . import definition
from .options import OK, Fov, Head, Height, Seed, Width, shown
from .progress import Display

SCENE = "text"  # its hard edges show what textures do; photographs are their texels
TECHNIQUE = "head_movement"
_ALSO = ("none", "ssaa4")  # in the reference and the default setting
_CSV = Path("hmdjit-trade-off") / "trade_off.csv"
_SESSIONS, _QUICK_SESSIONS = 48, 24


@dataclasses.dataclass(frozen=True)
class TradeOffCommand:
    """Measure seconds against error for every knob, on this machine.

    Takes 2 to 3 minutes on two idle cores, most of them to compile. Looks at the page
    of text: its hard edges show what textures do to the numbers, which photographs,
    whose texels are the texture's, do not. One knob is turned at a time; bias is
    measured by paired differences to the reference (texture 4x, float64). Of solids,
    rays are cast (reference: 64 rays per pixel for detail loss, float64); where nothing
    moves in them, a texture of what a head without a neck sees is held beside it.

    For example: hmdjit trade-off --scene fence --quick
    """

    scene: Annotated[
        str | None,
        shown("NAME", f"A scene of pictures or of solids, by name (default: {SCENE})."),
    ] = None
    images: Annotated[
        Path | None, shown("PATH", "A flat picture (PNG, JPEG) instead.")
    ] = None
    head: Head = None
    technique: Annotated[
        tuple[str, ...],
        shown("ID...", "Techniques to turn all knobs with"),
    ] = (TECHNIQUE,)
    sessions: Annotated[
        int | None,
        shown("N", f"Sessions of each setting (default: {_SESSIONS})."),
    ] = None
    seconds: Annotated[float, shown("S", "Time at which total errors are compared")] = (
        10.0
    )
    quick: Annotated[
        bool, shown("", f"The main knobs only, {_QUICK_SESSIONS} sessions: 45 seconds.")
    ] = False
    width: Width = None
    height: Height = None
    fov: Fov = None
    seed: Seed = 0
    out: Annotated[Path, shown("DIR", "Folder for what is written")] = _CSV.parent

    def run(self, console: rich.console.Console) -> int:
        """Measure, print and draw; an interruption keeps what is measured."""
        _checks.in_range("seconds", self.seconds, 0, open_low=True)
        sessions = self.sessions
        if sessions is None:
            sessions = _QUICK_SESSIONS if self.quick else _SESSIONS
        _checks.whole("sessions", sessions, 2)
        study, study_options = _study(self)
        chosen, also = knobs.single_knobs(study), []
        if self.quick:
            chosen = [one for one in chosen if one.name in knobs.QUICK]
        else:
            chosen = [*chosen, *knobs.combinations(study)]
            also = [techniques.by_id(id) for id in _ALSO]
        cases, misfits = settings.cases(
            study, chosen, also=also, is_with_samples=not self.quick
        )
        file = self.out / _CSV.name
        check_can_write(self.out)
        for name in misfits:
            console.out(f"Left out: {name} does not fit the camera.")
        console.out(
            f"Scene {next(iter(study.scenes))}: {len(cases)} settings and techniques x "
            f"{counted(sessions, 'session')}, one after the other. "
            f"Rows go to {file} as they come."
        )
        rows = []
        try:
            with Display(console) as display:
                for row in measurement.measure(
                    study,
                    cases,
                    seed=self.seed,
                    sessions=sessions,
                    study_options=study_options,
                    progress=display,
                ):
                    rows.append(row)
                    trade_off.write_csv(rows, file)
        except KeyboardInterrupt:
            kept = f"{len(rows)} of {len(cases)} rows are kept in {file}"
            raise KeyboardInterrupt(
                f"stopped; {kept if rows else 'no row was finished'}."
            ) from None
        console.print(trade_off_report.table(rows, self.seconds, console.width))
        console.out(trade_off_report.explanation(rows), style="dim")
        picture = save(trade_off_figure.draw(rows), file.with_suffix(".png"))
        console.out(f"Wrote {file} and {picture}.")
        return OK


@dataclasses.dataclass(frozen=True)
class PickCommand:
    """Choose the cheapest setting within a tolerance, or the best within a budget.

    From what `hmdjit trade-off` measured here. Names the options of `hmdjit study`.

    For example: hmdjit pick --tolerance 0.02
    """

    tolerance: Annotated[
        float | None,
        shown("SHARE", "Largest error of the mean MTCD, e.g. 0.02; in (0, 1)."),
    ] = None
    budget: Annotated[
        str | None, shown("TIME", "Time for one scene, e.g. 10s or 2min.")
    ] = None
    technique: Annotated[
        tuple[str, ...] | None,
        shown("ID...", "Techniques to choose for (default: those with all knobs)."),
    ] = None
    table: Annotated[
        Path,
        tyro.conf.arg(name="from"),
        shown("CSV", "Table of `hmdjit trade-off`"),
    ] = _CSV

    def run(self, console: rich.console.Console) -> int:
        """Choose a setting, and print how to run it."""
        if (self.tolerance is None) == (self.budget is None):
            raise ValueError(
                "name either --tolerance, e.g. 0.02, or --budget, e.g. 10s."
            )
        if self.tolerance is not None:
            _checks.in_range(
                "tolerance", self.tolerance, 0, 1, open_low=True, open_high=True
            )
        budget = None if self.budget is None else definition.seconds(self.budget)
        rows = trade_off.read_csv(self.table)
        found = choice.candidates(rows, self.technique)
        if budget is not None:
            chosen = choice.pick_budget(found, budget)
        else:
            assert self.tolerance is not None
            chosen = choice.pick_tolerance(found, self.tolerance)
        _print_choice(chosen, console)
        return OK


def _study(command: TradeOffCommand) -> tuple[Study, str]:
    """Study of one scene, and the options that name it."""
    if command.scene is not None and command.images is not None:
        raise ValueError("--scene and --images exclude each other: name one of them.")
    picture: dict[str, Any] = {"scenes": (command.scene or SCENE,)}
    if command.images is not None:
        picture = {"images": (command.images,)}
    ((option, (name,)),) = picture.items()
    options = definition.Options(
        **picture,
        head=command.head,
        techniques=command.technique,
        baseline=command.technique[0] if command.technique else None,
        width=command.width,
        height=command.height,
        fov=command.fov,
        seed=command.seed,
    )
    words = [f"--{option}", str(name), "--head", command.head or definition.HEAD]
    if command.fov is not None:
        words += ["--fov", f"{command.fov:g}"]
    if command.seed:
        words += ["--seed", str(command.seed)]
    return definition.build(options), shlex.join(words)


def _print_choice(chosen: Choice, console: rich.console.Console) -> None:
    first = chosen.rows[0]
    compile_s = sum(row.compile_s for row in chosen.rows) + first.bake_s
    console.out(f"Setting: {chosen.setting} ({first.identity['scene']}).")
    console.out(
        f"Sessions: {chosen.sessions:,}. Expected: {chosen.seconds:.3g} s of running "
        f"per scene, after about {compile_s:.0f} s to compile and bake; error below "
        f"{100 * chosen.error:.2g} % of MTCD (95 %, given the head)."
    )
    for row in chosen.rows:
        bias, error = (100 * x / row.reference_mtcd for x in (row.bias, row.bias_se))
        console.out(f"{row.technique}: bias {bias:+.3f} ± {Z95 * error:.3f} % of MTCD.")
    names = " ".join(row.technique for row in chosen.rows)
    console.out(
        f"hmdjit study {first.identity['study_options']} {first.setting_options} "
        f"--techniques {names} --sessions {chosen.sessions}"
    )
