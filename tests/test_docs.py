"""The guide: its code runs, its pictures exist, techniques have a page each."""

import importlib.util
import re
import sys
from pathlib import Path

import pytest

import hmdjit as hj

EXAMPLES = Path(__file__).parents[1] / "examples"
GUIDE = sorted((EXAMPLES / "guide").glob("*.md"))


@pytest.fixture(scope="module")
def docs():
    spec = importlib.util.spec_from_file_location("docs", EXAMPLES / "docs.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_all_pages_are_in_the_guide(docs):
    assert sorted(docs.GUIDE) == [page.stem for page in GUIDE]


@pytest.mark.slow
@pytest.mark.parametrize("page", GUIDE, ids=lambda page: page.stem)
def test_code_and_pictures_of_a_page_are_right(page):
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.S)
    assert blocks
    exec(compile("\n".join(blocks), page.name, "exec"), {})  # each goes on
    linked = re.findall(r"!\[.+?\]\(([^)]+)\)", text)
    assert [link for link in linked if not (page.parent / link).is_file()] == []


def test_each_family_has_a_page_with_its_facts(docs):
    pages = dict(docs.techniques())
    assert len(pages) == len(
        {type(hj.techniques.by_id(id)) for id in hj.techniques.IDS}
    )
    told = "\n".join(pages.values())
    assert all(f"`{id}`" in told for id in hj.techniques.IDS)
    assert "- `w_min`: 0.3" in pages["headmovement"]
    _, rows = docs.measured()
    assert " | ".join(rows["karis"]) in pages["karis"]


def test_one_command_renders_the_guide(docs, tmp_path, monkeypatch):
    pytest.importorskip("pdoc", reason="needs hmdjit[docs]")
    monkeypatch.setattr(sys, "argv", ["docs.py", "--guide", "--out", str(tmp_path)])
    monkeypatch.setattr(sys, "path", [*sys.path])
    docs.main()
    page = (tmp_path / "guide" / "concepts.html").read_text(encoding="utf-8")
    for link in re.findall(r'<img src="([^"]+\.png)"', page):
        assert (tmp_path / "guide" / link).is_file()
    assert (tmp_path / "guide" / "headmovement.html").is_file()
