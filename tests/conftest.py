import contextlib
import functools
import gc
import os
import pathlib
import shutil
import tempfile

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from hypothesis import settings

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_debug_key_reuse", True)
settings.register_profile("hmdjit", deadline=None, derandomize=True, max_examples=40)
settings.load_profile("hmdjit")

CACHE = "JAX_COMPILATION_CACHE_DIR"
CACHED = {  # by environment, for workers and for the commands that tests run
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": 0.0,
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": -1,
}

QUICKLY = (
    "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=1 "
    "--xla_cpu_parallel_codegen_split_count=1"
)


MOST_BYTES = 2**30


def _programs(config):
    """Folder of compiled programs: pytest's own, or one of this session alone.

    JAX names a program by all that it is made of, so that none is out of date. (It can
    bound the folder too, but then looks through all of it for each new program.)
    """
    with contextlib.suppress(AttributeError, OSError):  # no such plugin; read only
        folder = config.cache.mkdir("programs")
        if sum(file.stat().st_size for file in folder.iterdir()) > MOST_BYTES:
            shutil.rmtree(folder, ignore_errors=True)
        return str(folder)
    folder = tempfile.mkdtemp(prefix="hmdjit-programs-")
    config.add_cleanup(functools.partial(shutil.rmtree, folder, ignore_errors=True))
    return folder


def pytest_configure(config):
    """Keep compiled programs in one folder for all processes, and later sessions."""
    if CACHE not in os.environ:
        os.environ[CACHE] = _programs(config)
        config.add_cleanup(functools.partial(os.environ.pop, CACHE))
    jax.config.update(CACHE.lower(), os.environ[CACHE])
    for name, usual in CACHED.items():
        value = type(usual)(os.environ.setdefault(name, str(usual)))
        jax.config.update(name.lower(), value)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # of each worker
    if "not slow" in config.option.markexpr:
        # Optimising a program takes longer than all the rest of a quick test. (Without
        # any optimisation XLA's other emitters compute wrong pictures.) Workers, and
        # commands that tests run, read the variable.
        os.environ.setdefault("XLA_FLAGS", QUICKLY)


def pytest_collection():
    """What is imported stays: no need to look for garbage in it again and again."""
    gc.disable()


def pytest_collection_finish():
    gc.freeze()
    gc.enable()
    gc.set_threshold(20_000, 20, 20)  # tracing makes and drops many small objects


@pytest.fixture(autouse=True, scope="module")
def _forget_programs():
    """Free what modules compiled: a process may map only 65,530 pieces of memory.

    Programs that later modules share are then read from their folder.
    """
    yield
    maps = pathlib.Path("/proc/self/maps")
    if not maps.exists() or maps.read_text().count("\n") > 30_000:
        jax.clear_caches()


@pytest.fixture
def key():
    return jax.random.key(20260101)


@pytest.fixture
def rng():
    return np.random.default_rng(20260101)


@pytest.fixture
def file(tmp_path):
    """Write a small file, and name it."""

    def write(content, name="me.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.fixture
def untyped():
    """What users get: the tests' hook would refuse a wrong type before a check."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@functools.cache
def _jitted(function):
    return jax.jit(function)


@functools.cache
def _batched(function):
    return jax.jit(jax.vmap(function))


@pytest.fixture(scope="session", params=["plain", "jit", "vmap"])
def variant(request):
    """Call a function as it is, inside `jit`, or as the second of a batch of two."""

    def in_a_batch(function):
        def call(*args):
            double = lambda leaf: jnp.stack([jnp.zeros_like(leaf), leaf])
            batch = jax.tree.map(double, args)
            return jax.tree.map(lambda leaf: leaf[1], _batched(function)(*batch))

        return call

    forms = {"plain": lambda function: function, "jit": _jitted, "vmap": in_a_batch}
    return forms[request.param]


@pytest.fixture(scope="session")
def shared():
    """The folder of recorded heads and published metric values, beside the project."""
    folder = os.path.join(os.path.dirname(__file__), "..", "..", "shared")
    if not os.path.isdir(os.path.join(folder, "traces")):
        pytest.skip("no recorded traces beside the project")
    return os.path.abspath(folder)
