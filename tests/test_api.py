import ast
import importlib
import inspect
import pkgutil
from pathlib import Path

import jax
import jaxtyping

import hmdjit
from hmdjit._types import RandomKey

ROOT = Path(hmdjit.__file__).parent


def public_modules():
    yield hmdjit
    for info in pkgutil.walk_packages(hmdjit.__path__, "hmdjit."):
        if not any(part.startswith("_") for part in info.name.split(".")):
            yield importlib.import_module(info.name)


def is_function(thing):
    # Also what `jit` or another decorator returned, as long as it wraps a function.
    return inspect.isfunction(inspect.unwrap(thing)) if callable(thing) else False


def public_things(module):
    for name, thing in vars(module).items():
        is_own = getattr(thing, "__module__", None) == module.__name__
        is_public = is_own and not name.startswith("_")
        if is_public and (inspect.isclass(thing) or is_function(thing)):
            yield f"{module.__name__}.{name}", thing


def methods(cls):
    for name, thing in vars(cls).items():
        # What a classmethod, staticmethod or property is made of:
        function = getattr(thing, "__func__", getattr(thing, "fget", thing))
        is_own = is_function(function) and inspect.unwrap(function).__module__
        if is_own == cls.__module__ and not name.startswith("_"):
            yield f"{cls.__module__}.{cls.__qualname__}.{name}", function


THINGS = dict(pair for module in public_modules() for pair in public_things(module))
CLASSES = {name: thing for name, thing in THINGS.items() if inspect.isclass(thing)}
FUNCTIONS = {name: thing for name, thing in THINGS.items() if name not in CLASSES}
METHODS = dict(pair for cls in CLASSES.values() for pair in methods(cls))
CALLABLES = FUNCTIONS | METHODS


def parameters(function):
    found = inspect.signature(function).parameters.values()
    return [p for p in found if p.name not in ("self", "cls")]


def is_random_key(parameter):
    return getattr(parameter.annotation, "dtype", None) is jaxtyping.Key


def doc(thing):
    return (inspect.getdoc(thing) or "").strip()


def re_exports():
    tree = ast.parse((ROOT / "__init__.py").read_text("utf-8"))
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.level:
            yield from node.names


def test_the_search_finds_what_is_there():
    assert "hmdjit.quaternion.slerp" in FUNCTIONS
    assert "hmdjit.camera.Camera" in CLASSES
    assert "hmdjit.camera.Region.whole" in METHODS
    assert "hmdjit.camera.Camera.focal_px" in METHODS
    assert not any("._" in name for name in THINGS | METHODS)


def test_the_search_knows_a_random_key():
    def sample(rate_hz: float, key: RandomKey, name: str) -> jax.Array: ...

    assert [is_random_key(p) for p in parameters(sample)] == [False, True, False]


def test_a_random_key_is_the_first_argument():
    def is_late(function):
        return any(is_random_key(p) for p in parameters(function)[1:])

    late = [name for name, thing in CALLABLES.items() if is_late(thing)]
    assert not late


def test_public_things_are_documented():
    silent = [name for name, thing in (THINGS | METHODS).items() if not doc(thing)]
    assert not silent


def test_public_functions_are_annotated():
    def is_bare(function):
        signature = inspect.signature(function)
        annotations = [p.annotation for p in parameters(function)]
        return signature.empty in [*annotations, signature.return_annotation]

    bare = [name for name, thing in CALLABLES.items() if is_bare(thing)]
    assert not bare


def test_what_is_offered_exists():
    for module in public_modules():
        for name in getattr(module, "__all__", ()):
            assert hasattr(module, name), f"{module.__name__}.{name}"
    for alias in re_exports():
        assert alias.asname == alias.name, "written `from .x import Name as Name`"
        assert hasattr(hmdjit, alias.name)


def test_what_is_offered_is_few():
    offered = {alias.name for alias in re_exports()}
    assert len(offered | set(getattr(hmdjit, "__all__", ()))) <= 25
