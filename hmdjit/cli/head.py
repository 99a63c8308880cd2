"""The command line's `hmdjit head`: fit, describe and sample how heads move."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import rich.console
import tyro
from scipy.spatial.transform import Rotation

from .. import _checks, _toml
from .._files import files_beside
from .._version import __version__
from ..figures import head as head_figure
from ..figures.drawing import save
from ..head_fitting import fitting, spectra, statistics
from ..head_fitting.statistics import Goodness
from ..head_motion import HeadMotion, Trace, presets
from ..head_motion.trace_clock import RATES_HZ
from ..reports import head as head_report
from ..studies.identity import counted
from ..studies.sessions import drawn_alike, study_key
from ..studies.study import check_seed
from .definition import HEAD, head_model
from .options import OK, PoseLog, shown

_MOST_FRAMES = 10**7
_DRAWS = 16  # of a model, beside each recording
_MOST_DRAWN_FRAMES = 2 * 10**6  # of a model, beside a sample


@dataclasses.dataclass(frozen=True)
class Recordings(PoseLog):
    """Recordings, and how they are read."""

    traces: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        shown("TRACE...", "Recorded heads: tables or pose logs."),
    ] = ()
    max_speed: Annotated[
        float, shown("DEG/S", "RMS speed within 0.5 s that is still (default: 5).")
    ] = 5.0

    def read(self, console: rich.console.Console) -> list[Trace]:
        """Read the traces, each once."""
        _checks.in_range("max_speed", self.max_speed, 0, open_low=True)
        console.out(f"Reading {counted(len(self.traces), 'recording')}.")
        traces = [self.read_trace(path) for path in self.traces]
        for trace in traces:
            for note in trace.notes:
                console.out(note)
        return traces

    def still(
        self, console: rich.console.Console, traces: list[Trace]
    ) -> tuple[list[Trace], float]:
        """Find where heads are still, and say how much that is."""
        segments, rate_hz = fitting.still_data(traces, self.max_speed)
        if not segments:
            raise fitting.NotEnoughDataError(
                "traces must hold still for 2 s at a time, below "
                f"{self.max_speed:g} deg/s; none of {len(traces)} recordings does."
            )
        head_report.print_recordings(console, traces, segments, rate_hz)
        return segments, rate_hz

    @property
    def name(self) -> str:
        """What a figure calls them."""
        others = len(self.traces) - 1
        return self.traces[0].name + (f" and {others} more" if others else "")


_Recordings = tyro.conf.OmitArgPrefixes[Recordings]


@dataclasses.dataclass(frozen=True)
class Fit:
    """Fit the head model to recorded heads: a TOML file, and a figure beside it.

    For example: hmdjit head fit PERSON_1.csv PERSON_2.csv --out mine.toml
    """

    recordings: _Recordings
    order: Annotated[
        int | None, shown("N", "Resonances per axis, 0 to 2 (default: as many as pay)")
    ] = None
    out: Annotated[Path, shown("TOML", "File for the model (default: head.toml).")] = (
        Path("head.toml")
    )

    def run(self, console: rich.console.Console) -> None:
        """Fit, print, draw and write."""
        (figure_file,) = files_beside(self.out, ".toml", ".png")
        recordings = self.recordings
        traces = recordings.read(console)
        segments, rate_hz = recordings.still(console, traces)
        what = "orders 0, 1 and 2, of which held-out data choose one: some minutes."
        if self.order is not None:
            what = f"order {self.order}: about a minute, most of it to compile."
        console.print(f"Fitting {what}")
        with console.status("fitting"):
            fit = fitting.fit_heads(
                traces, order=self.order, max_speed_deg_s=recordings.max_speed
            )
        head_report.print_fit(console, fit)
        goodness = _beside(console, fit.head, segments, rate_hz)
        title = f"{self.out.name}, fitted to {recordings.name}"
        figure = head_figure.draw(
            title, segments, goodness.recorded, fit.head, goodness.model
        )
        save(figure, figure_file, tight=False)
        presets.write(self.out, fit.head, _about(fit, traces, recordings.max_speed))
        console.out(f"Wrote {self.out} and {figure_file}.")


@dataclasses.dataclass(frozen=True)
class Describe:
    """Say what recorded heads do while they are still: a table and a figure.

    For example: hmdjit head describe PERSON_1.csv --model mine.toml
    """

    recordings: _Recordings
    model: Annotated[
        str | None, shown("NAME|TOML", "Head model to set beside them.")
    ] = None
    out: Annotated[
        Path, shown("PNG", "File for the figure (default: describe.png).")
    ] = Path("describe.png")

    def run(self, console: rich.console.Console) -> None:
        """Measure, print and draw."""
        (figure_file,) = files_beside(self.out, ".png", ".png")
        head = None if self.model is None else head_model(self.model)
        recordings = self.recordings
        segments, rate_hz = recordings.still(console, recordings.read(console))
        if head is None:
            recorded, model = statistics.describe(segments, rate_hz), None
            head_report.print_description(console, recorded)
        else:
            recorded, model, *_ = _beside(console, head, segments, rate_hz)
        title = recordings.name + (f" beside {self.model}" if head else "")
        figure = head_figure.draw(title, segments, recorded, head, model)
        save(figure, figure_file, tight=False)
        console.out(f"Wrote {figure_file}.")


@dataclasses.dataclass(frozen=True)
class Sample:
    """Draw a person's session from a head model: a trace, and a figure beside it.

    For example: hmdjit head sample --model seated --out seated.csv
    """

    model: Annotated[str, shown("NAME|TOML", f"Head model (default: {HEAD}).")] = HEAD
    rate: Annotated[float, shown("HZ", "Frame rate (default: 90).")] = 90.0
    seconds: Annotated[float, shown("S", "Duration, at least 4 (default: 60).")] = 60.0
    seed: Annotated[int, shown("N", "Seed of the draw (default: 0).")] = 0
    out: Annotated[Path, shown("CSV", "File for the trace (default: sample.csv).")] = (
        Path("sample.csv")
    )

    def run(self, console: rich.console.Console) -> None:
        """Draw a session, print and draw what it does, write it."""
        (figure_file,) = files_beside(self.out, ".csv", ".png")
        head, rate_hz = head_model(self.model), self.rate
        check_seed(self.seed)
        _checks.in_range("rate", rate_hz, *RATES_HZ)
        longest_s = _MOST_FRAMES / rate_hz
        _checks.in_range("seconds", self.seconds, spectra.WINDOW_S, longest_s)
        frames = round(self.seconds * rate_hz) + 1
        with drawn_alike():
            path = head.rotation_vectors(study_key(self.seed), rate_hz, frames)
        poses = Rotation.from_rotvec(np.array(path, float)).as_quat(scalar_first=True)
        trace = Trace(np.arange(frames) / rate_hz, poses, name=self.out.name)
        draws = max(1, min(_DRAWS, _MOST_DRAWN_FRAMES // frames))
        goodness = _beside(console, head, [trace], rate_hz, word="drawn", draws=draws)
        figure = head_figure.draw(
            f"A person drawn from {self.model}, seed {self.seed}",
            [trace],
            goodness.recorded,
            head,
            goodness.model,
            word="drawn",
        )
        save(figure, figure_file, tight=False)
        trace.write(self.out)
        console.out(f"Wrote {self.out} and {figure_file}.")


_Command = tyro.conf.OmitArgPrefixes[Fit | Describe | Sample]


@dataclasses.dataclass(frozen=True)
class HeadCommand:
    """How heads move: fit a model to recordings, describe them, sample a model.

    For example: hmdjit head describe ME.csv
    """

    command: tyro.conf.OmitSubcommandPrefixes[_Command]

    def run(self, console: rich.console.Console) -> int:
        """Run its command; files are written last, each whole or not at all."""
        # An axis that does not move at all has no kurtosis and no logarithm.
        with np.errstate(divide="ignore", invalid="ignore"):
            self.command.run(console)
        return OK


def _about(
    fit: fitting.Fit, traces: list[Trace], max_speed_deg_s: float
) -> dict[str, Any]:
    rests_on = {
        "order": len(fit.head.resonators),
        "subjects": fit.subjects,
        "windows": fit.windows,
        "still_s": fit.still_s,
        "recorded_s": fit.recorded_s,
        "rate_hz": fit.rate_hz,
        "max_speed_deg_s": max_speed_deg_s,
        "clusters": fit.clusters,
        "hmdjit_version": __version__,
    }
    return {
        "source": ", ".join(trace.name for trace in traces),
        "fit": rests_on,
        "standard_error": _toml.table(fit.standard_error),
    }


def _beside(
    console: rich.console.Console,
    head: HeadMotion,
    segments: list[Trace],
    rate_hz: float,
    *,
    word: str = "recorded",
    draws: int = _DRAWS,
) -> Goodness:
    """Hold a model against heads, and print both."""
    with console.status("drawing from the model"), drawn_alike():
        key = study_key(0)
        goodness = statistics.goodness(key, head, segments, rate_hz, draws=draws)
    head_report.print_goodness(console, goodness, word=word)
    return goodness
