"""What the figures of a study read: sessions, rows, and one style per technique."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..camera import Camera
from ..estimates.summary import SummaryRow
from ..studies.identity import footer, metric_ids, metric_words
from .drawing import COLOURS, DASHES, SMALL, panels

if TYPE_CHECKING:
    import xarray

_MARKERS = ["o", "s", "D", "^", "v", "P", "X"]


class Compared:
    """The techniques of a study: `mtcd` by technique, scene and session; rows by cell.

    `style` holds colour, dashes and marker; the baseline's is black. `mtcd` is the
    headline, whatever metric that is; `headline` and `unit` are its words, and
    `more_is_better` says which way it is read.
    """

    def __init__(self, dataset: "xarray.Dataset", rows: Sequence[SummaryRow]):
        self.metrics = metric_ids(dataset)
        headline = self.metrics[0]
        self.is_flicker = headline == "mtcd"
        self.headline, self.unit = metric_words(headline), "code values of 8 bits"
        about = dataset[headline].attrs
        if not self.is_flicker:
            self.unit = str(about.get("units", "unknown units"))
        words = [] if self.unit == "1" else [self.unit]
        self.more_is_better = about.get("better") == "more"
        words += ["more is better"] * self.more_is_better
        self.unit = ", ".join(words)
        order = ("technique", "scene", "session")
        self.mtcd = dataset[self.metrics[0]].transpose(*order).values.astype(float)
        self.techniques = [str(t) for t in dataset["technique"].values]
        self.scenes = [str(s) for s in dataset["scene"].values]
        self.rows = {(row.technique, row.scene): row for row in rows}
        self.baseline = str(dataset.attrs["baseline"])
        self.reference = str(dataset.attrs.get("reference", ""))
        self.clustered = "subject" in dataset.coords
        self.footer = footer(dataset)
        names = ("width_px", "height_px", "fov_deg", "refresh_hz")
        known = [dataset.attrs.get(name, 1) for name in names]
        self.camera = Camera(int(known[0]), int(known[1]), *map(float, known[2:]))
        self.others = [t for t in self.techniques if t != self.baseline]
        self.style = styles(self.baseline, self.others)

    def points(self, technique: str) -> dict[str, Any]:
        """Return colour and marker of a technique's points."""
        colour, _, marker = self.style[technique]
        return {"color": colour, "marker": marker}

    def label(self, technique: str) -> str:
        """Return the technique's id and its role in the study."""
        role = {self.reference: " (reference)", self.baseline: " (baseline)"}
        return technique + role.get(technique, "")

    def axes(
        self, width: float, height: float, title: str, subtitle: str = ""
    ) -> tuple[Figure, Axes]:
        """Return an empty figure, inches, with its titles and footer."""
        figure, ((axes,),) = panels(width, height, self.footer)
        axes.set_title(title, pad=22)
        place = {"xycoords": "axes fraction", "textcoords": "offset points"}
        axes.annotate(subtitle, (0, 1), (0, 6), va="bottom", **place, **SMALL)
        return figure, axes


def styles(baseline: str, others: Sequence[str]) -> dict[str, tuple[str, Any, str]]:
    """Give each technique a colour, dashes and a marker; the baseline is black."""
    count = len(COLOURS)
    found: dict[str, tuple[str, Any, str]] = {baseline: ("black", "-", "o")}
    for i, technique in enumerate(others):
        turn = i // count
        marker = _MARKERS[(i + turn) % count]
        found[technique] = (COLOURS[i % count], DASHES[turn % 3], marker)
    return found
