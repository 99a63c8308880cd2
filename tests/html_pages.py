"""What a page of HTML holds, as its parser finds it."""

import json
import re
from html.parser import HTMLParser

_EMPTY = {"meta", "link", "img", "input", "br"}


class Page(HTMLParser):
    """Tags of a page with their attributes, its words, and what is left open."""

    def __init__(self, text):
        super().__init__()
        self.text, self.open, self.tags, self.words = text, [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs), [*self.open]))
        if tag not in _EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.words.append(data)

    def of(self, tag):
        return [(attrs, inside) for name, attrs, inside in self.tags if name == tag]

    @property
    def said(self):
        return " ".join(" ".join(self.words).split())

    @property
    def clips(self):
        found = re.search(r'<script type="application/json">(.*?)</script>', self.text)
        assert found is not None
        return json.loads(found[1])


def checked(path):
    """Read a page: well formed, small, self-contained, described."""
    assert path.stat().st_size < 8e6
    page = Page(path.read_text(encoding="utf-8"))
    assert page.open == []
    assert "http:" not in page.text
    assert "https:" not in page.text
    for _, attrs, _ in page.tags:
        for name in ("src", "href"):
            assert attrs.get(name, "data:").startswith(("data:", "#"))
    assert "default-src 'none'" in page.text
    images, figures = page.of("img"), page.of("figure")
    assert len(images) == len(figures) > 0
    assert all(len(attrs["alt"]) > 30 for attrs, _ in images)
    folded = [inside for _, inside in page.of("table") if "details" in inside]
    assert len(folded) == len(figures)
    assert page.of("html")[0][0]["lang"] == "en"
    ids = {attrs["id"] for _, attrs, _ in page.tags if "id" in attrs}
    assert {attrs["href"][1:] for attrs, _ in page.of("a")} <= ids
    return page
