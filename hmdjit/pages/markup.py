"""One self-contained HTML page: tables, figures with their numbers, clips, scripts.

Nothing is loaded from anywhere: pictures are data URIs, and the page's own policy
forbids all else. Whatever a user may have named is escaped.
"""

import base64
import dataclasses
import importlib.resources
import io
import json
import os
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np
from jaxtyping import Float
from rich.text import Text

from .._files import written_atomically
from ..color import CODE_VALUES
from ..reports.tables import Continued

_ROOM = importlib.resources.files("hmdjit.pages")
_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'"
)
CLIPS_BYTES = 3_500_000
"""What the clips of a viewer may take, as PNG; a page stays below 8 MB."""


@dataclasses.dataclass(frozen=True)
class Picture:
    """A figure of a page: PNG, what it shows in words, and its numbers.

    `is_chart`: lines on white, whose colours a dark page turns round.
    """

    png: bytes
    alt: str
    caption: str
    numbers: Continued
    is_chart: bool = True


def page(title: str, about: str, sections: Mapping[str, Sequence[str]]) -> str:
    """Return a page of headed sections, each of pieces of HTML."""
    own = lambda name: _ROOM.joinpath(name).read_text("utf-8")
    names = {heading: _anchor(heading) for heading in sections}
    links = "".join(
        f'<li><a href="#{anchor}">{escape(heading)}</a></li>'
        for heading, anchor in names.items()
    )
    body = "\n".join(
        f'<section aria-labelledby="{names[heading]}"><h2 id="{names[heading]}">'
        f"{escape(heading)}</h2>\n{''.join(pieces)}</section>"
        for heading, pieces in sections.items()
    )
    script = ""
    if 'class="viewer"' in body:
        script = f"<script>{own('viewer.js')}</script>"
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark"><link rel="icon" href="data:,">'
        f"<title>{escape(title)}</title><style>{own('page.css')}</style></head>\n"
        f'<body><header><h1>{escape(title)}</h1><p class="about">{escape(about)}</p>'
        f'</header><nav aria-label="Sections"><ul>{links}</ul></nav>\n<main>{body}'
        f"</main>{script}</body></html>\n"
    )


def write(path: str | os.PathLike, content: str) -> Path:
    """Write a page, whole or not at all."""
    with written_atomically(path) as unfinished:
        unfinished.write_text(content, encoding="utf-8")
    return Path(path)


def paragraph(words: str, kind: str = "") -> str:
    """Return a paragraph."""
    return f"<p{f' class={kind}' * bool(kind)}>{escape(words)}</p>"


def code(words: str) -> str:
    """Return a line to be typed."""
    return f'<pre tabindex="0"><code>{escape(words)}</code></pre>'


def table(content: Continued, caption: str) -> str:
    """Return the table that a terminal would show; a narrow window scrolls it."""
    cell = lambda x: escape(x.plain if isinstance(x, Text) else str(x))
    side = lambda k: ' class="words"' if content.sides[k] == "left" else ""
    head = "".join(
        f'<th scope="col"{side(k)}>{cell(name) or "&#8203;"}</th>'
        for k, name in enumerate(content.columns)
    )
    rows = []
    for row in content.rows:
        if row is None:
            rows.append("</tbody><tbody>")
            continue
        cells, look = row
        first, *rest = map(cell, cells)
        others = "".join(f"<td{side(k)}>{x}</td>" for k, x in enumerate(rest, start=1))
        strong = ' class="strong"' if look else ""
        rows.append(
            f'<tr{strong}><th scope="row" class="words">{first}</th>{others}</tr>'
        )
    words = escape(caption)
    return (
        f'<div class="scroll" role="region" aria-label="{words}" tabindex="0"><table>'
        f"<caption>{words}</caption><thead><tr>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def figure(picture: Picture) -> str:
    """Return a figure, with its numbers in a table that unfolds."""
    alt, caption = escape(picture.alt), escape(picture.caption)
    kind = "chart" if picture.is_chart else "picture"
    return (
        f'<figure><div class="scroll" role="region" aria-label="Figure: {caption}" '
        f'tabindex="0"><img class="{kind}" alt="{alt}" src="{_uri(picture.png)}"></div>'
        f"<figcaption>{caption}</figcaption><details><summary>Numbers of this figure"
        f"</summary>{table(picture.numbers, caption)}</details></figure>"
    )


def viewer(
    clips: Mapping[str, Float[np.ndarray, "frames height width 3"]],
    rate_hz: float,
    chosen: tuple[str, str],
) -> str:
    """Return two clips side by side, of those that there are, rounded to 8 bits.

    Of all clips as many frames are kept as fit into `CLIPS_BYTES`.
    """
    frames, height, width, _ = next(iter(clips.values())).shape
    alike: dict[bytes, str] = {}  # what is displayed by several is kept once
    first = {
        name: alike.setdefault(clip.tobytes(), name) for name, clip in clips.items()
    }
    size = frames * sum(len(_sprite(clips[name][:1])) for name in alike.values())
    frames = max(2, min(frames, int(frames * CLIPS_BYTES / size)))
    sprites = {name: _uri(_sprite(clips[name][:frames])) for name in alike.values()}
    known = {
        "rate": rate_hz,
        "frames": frames,
        "width": width,
        "height": height,
        "sprites": sprites,
        "names": first,
    }
    # A name of a user's own ends no script.
    data = json.dumps(known).replace("<", "\\u003c")
    sides = "".join(_side(k, list(clips), name) for k, name in enumerate(chosen))
    zoom = max(4, min(width, height) // 4)
    ranges = "".join(
        f'<label>{words} <input type="range" data-axis="{axis}" min="0" '
        f'max="{most - zoom}" value="{(most - zoom) // 2}"></label>'
        for axis, words, most in (
            ("x", "magnified: from the left", width),
            ("y", "from the top", height),
        )
    )
    return (
        f'<div class="viewer" role="group" aria-label="Flicker viewer" '
        f'data-zoom="{zoom}"><div class="controls"><button type="button" '
        'data-do="play">Play</button><button type="button" data-do="back">Step back'
        '</button><button type="button" data-do="step">Step</button>'
        f'<output aria-live="polite"></output></div><div class="sides">{sides}</div>'
        f'<div class="controls">{ranges}</div>'
        f'<script type="application/json">{data}</script></div>'
        f"<p>{frames} frames at {rate_hz:.4g} Hz, without loss at 8 bits, forth and "
        "back: so no jump at a loop's end is taken for flicker. A screen at another "
        "rate shows some frames twice, or leaves some out.</p>"
        "<noscript><p>The viewer needs JavaScript, which is off.</p></noscript>"
    )


def _side(k: int, names: Sequence[str], chosen: str) -> str:
    options = "".join(
        f'<option value="{escape(name)}"{" selected" * (name == chosen)}>'
        f"{escape(name)}</option>"
        for name in names
    )
    where = ("left", "right")[k]
    return (
        f'<div class="side"><label>{where} <select>{options}</select></label>'
        f'<canvas class="whole" role="img" aria-label="Displayed frame, {where}">'
        f'</canvas><canvas class="zoom" role="img" aria-label="The same, magnified, '
        f'{where}"></canvas></div>'
    )


def _sprite(clip: Float[np.ndarray, "frames height width 3"]) -> bytes:
    """Frames below each other, as one PNG."""
    import PIL.Image

    codes = np.floor(CODE_VALUES * np.clip(clip, 0, 1) + 0.5).astype(np.uint8)
    image = PIL.Image.fromarray(codes.reshape(-1, *codes.shape[2:]))
    with io.BytesIO() as content:
        image.save(content, format="PNG")
        return content.getvalue()


def _uri(png: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"


def _anchor(heading: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", heading.lower()).strip("-")
