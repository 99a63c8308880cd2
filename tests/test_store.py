import functools
import os
import stat
from collections.abc import Callable

import equinox as eqx
import numpy as np
import pytest
import xarray

import hmdjit as hj
from hmdjit import curves
from hmdjit._files import written_atomically
from hmdjit.simulation.session import Result
from hmdjit.studies.dataset import write_dataset
from hmdjit.studies.store import Store, batch_words, fingerprint, without_version


def test_fingerprint_depends_on_every_number_and_type():
    kim = hj.techniques.HeadMovement
    parts = [
        kim(),
        kim(w_min=0.31),
        kim(closeness=(0.5,)),
        kim(resolve=hj.techniques.SSAA(2)),
        kim(space="linear"),
        kim(ease=curves.Linear()),
        kim(ease=curves.Cosine(2.0)),
        kim(ease=curves.Cosine(2.5)),
        kim(localization=curves.Kim()),
        kim(localization=curves.Spline((1, 2, 1))),
        hj.Camera(),
        hj.Camera(fov_deg=95.0),
        hj.HeadMotion.seated(),
        np.zeros(3),
        np.zeros(3, np.float32),
        np.zeros((3, 1)),
        [1, [2]],
        [1, 2],
        1,
        1.0,
        "1",
        True,
        None,
        {"a": 1},
        {"b": 1},
    ]
    assert len({fingerprint(part) for part in parts}) == len(parts)
    assert fingerprint(kim()) == fingerprint(kim())


def test_a_label_changes_no_fingerprint():
    kim = hj.techniques.HeadMovement
    assert fingerprint(kim(label="a")) == fingerprint(kim(label="b"))


def test_fingerprint_refuses_what_it_cannot_take_apart():
    with pytest.raises(TypeError, match="fingerprint of: object"):
        fingerprint(object())


class Mine(hj.techniques.NoAntialiasing):
    """Of a user's own."""


class Versioned(Mine):
    version = 1


class Renewed(Mine):
    version = 2


Renewed.__qualname__ = "Versioned"


class Heir(Versioned):
    """Adds code of which the version that it inherits says nothing."""


def test_what_no_version_knows_is_named():
    kim = hj.techniques.HeadMovement
    assert without_version(Versioned(), kim(), hj.Camera(), [1, "a", None]) == []
    assert without_version(Mine()) == ["Mine"]
    assert without_version(kim(resolve=Heir()), {"a": [Mine()]}) == ["Heir", "Mine"]
    assert fingerprint(Versioned()) != fingerprint(Renewed())


class Chosen(hj.techniques.NoAntialiasing):
    """Of a function that its user gives."""

    version = 1
    function: Callable = eqx.field(static=True, default=np.sin)


def test_functions_are_known_by_no_version():
    assert without_version(Chosen(len), np.sin, functools.partial(len)) == [
        "len",
        "sin",
        "partial",
    ]
    assert fingerprint(Chosen()) != fingerprint(Chosen(np.cos))


def result(count, value=0.0):
    return Result({"mtcd": np.full(count, value), "detail_loss": np.ones(count)})


def find(store, name, key):
    """All that is known of a scene, by technique."""
    known = {}
    for _, results in store.found(name, key):
        known |= results
    return known


def test_a_kept_batch_is_found_by_its_key_only(tmp_path):
    store = Store(tmp_path)
    store.keep("noise-0", "a" * 64, 0, {"f" * 64: result(2, 1.5), "e" * 64: result(2)})
    found = find(store, "noise-0", "a" * 64)
    assert set(found) == {"e" * 64, "f" * 64}
    np.testing.assert_array_equal(found["f" * 64].mtcd, [1.5, 1.5])
    np.testing.assert_array_equal(found["f" * 64].detail_loss, [1.0, 1.0])
    assert not find(store, "noise-0", "b" * 64)
    assert not find(store, "noise-1", "a" * 64)
    assert [path.suffix for path in (tmp_path / "batches").iterdir()] == [".npz"]


def test_a_technique_that_came_later_is_found_beside_the_others(tmp_path):
    store = Store(tmp_path)
    store.keep("noise-0", "a" * 64, 0, {"e" * 64: result(2, 1.0)})
    store.keep("noise-0", "a" * 64, 0, {"f" * 64: result(2, 2.0)})
    found = find(store, "noise-0", "a" * 64)
    assert [found[key * 64].mtcd[0] for key in "ef"] == [1.0, 2.0]


def test_names_of_kept_batches_are_names_of_files_anywhere(tmp_path):
    store, name = Store(tmp_path), "a+b-<b/c>[1]-0"
    store.keep(name, "a" * 64, 0, {"f" * 64: result(1)})
    (file,) = (tmp_path / "batches").iterdir()
    assert file.name.startswith(f"a+b-_b_c_[1]-0-{'a' * 16}-0-1-")
    assert find(store, name, "a" * 64)


def test_names_of_kept_batches_fit_any_file_system(tmp_path):
    store, names = Store(tmp_path), ["a" * 230, "\N{CJK UNIFIED IDEOGRAPH-56F3}" * 230]
    for name in names:
        store.keep(f"{name}-0", "a" * 64, 0, {"f" * 64: result(1)})
        assert find(store, f"{name}-0", "a" * 64)
    for file in (tmp_path / "batches").iterdir():
        assert len(file.name.encode()) < 200


@pytest.fixture
def full_disk():
    """Let no file become larger than 100 bytes."""
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_full_disk_is_told_with_the_file(tmp_path, full_disk):
    dataset = xarray.Dataset({"mtcd": ("session", np.zeros(9))})
    with pytest.raises(OSError, match="too large") as stop:
        write_dataset(dataset, tmp_path / "result.nc")
    assert stop.value.filename == str(tmp_path / "result.nc")
    with pytest.raises(OSError, match="too large") as stop:
        Store(tmp_path).keep("noise-0", "a" * 64, 0, {"f" * 64: result(50)})
    assert "noise-0-aaaaaaaaaaaaaaaa-" in str(stop.value.filename)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_what_cannot_be_read_meanwhile_is_told_by_its_own_name(tmp_path):
    with (
        pytest.raises(FileNotFoundError) as stop,
        written_atomically(tmp_path / "written"),
    ):
        open(tmp_path / "missing").close()
    assert stop.value.filename == str(tmp_path / "missing")


def test_batches_are_found_by_their_sessions(tmp_path):
    store, key = Store(tmp_path), "a" * 64
    for start, size in ((0, 2), (2, 1), (12, 2)):
        store.keep("noise", key, start, {"f" * 64: result(size)})
    assert sorted(start for start, _ in store.found("noise", key)) == [0, 2, 12]
    assert [start for start, _ in store.found("noise", key, batch_words(2, 1))] == [2]
    assert not list(store.found("noise", key, batch_words(2, 2)))


def test_a_damaged_batch_counts_as_unfinished(tmp_path):
    store = Store(tmp_path)
    store.keep("x", "a" * 64, 0, {"f" * 64: result(50)})
    (file,) = (tmp_path / "batches").iterdir()
    whole = file.read_bytes()
    altered = [bytearray(whole) for _ in range(3)]
    for content, place in zip(altered, (0, len(whole) // 2, -1), strict=True):
        content[place] ^= 1
    for content in (b"", b"rubbish", whole[: len(whole) // 2], *altered):
        file.write_bytes(content)
        assert not find(store, "x", "a" * 64)
        assert store.damaged.pop() == file
    file.write_bytes(whole)
    assert find(store, "x", "a" * 64)
    # Of other sessions than it says.
    file.rename(file.with_name(file.name.replace("-0-50-", "-50-50-")))
    assert not find(store, "x", "a" * 64)
    store.keep("x", "a" * 64, 0, {"f" * 64: result(50)})
    assert find(store, "x", "a" * 64)


def test_a_folder_that_vanished_is_told_and_not_made_again(tmp_path):
    store = Store(tmp_path / "out")
    (tmp_path / "out/batches").rmdir()
    (tmp_path / "out").rmdir()
    with pytest.raises(FileNotFoundError) as stop:
        store.keep("x", "a" * 64, 0, {"f" * 64: result(1)})
    assert str(stop.value.filename).startswith(f"{tmp_path}/out/batches/x-aaaa")
    assert not (tmp_path / "out").exists()


def test_what_is_written_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    done = []
    replace, sync = os.replace, os.fsync

    def synced(handle):
        done.append("folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "file")
        sync(handle)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", lambda *a: (done.append("name"), replace(*a)))
    with written_atomically(tmp_path / "a") as unfinished:
        unfinished.write_bytes(b"a")
    assert done == ["file", "name", "folder"]


def test_a_store_without_a_folder_keeps_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    store = Store(None)
    store.keep("x", "a" * 64, 0, {"f" * 64: result(1)})
    assert not find(store, "x", "a" * 64)
    assert not list(tmp_path.iterdir())
