import os

import jax
import numpy as np
import pytest
from hypothesis import settings

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_debug_key_reuse", True)
settings.register_profile("hmdjit", deadline=None, derandomize=True)
settings.load_profile("hmdjit")


@pytest.fixture
def key():
    return jax.random.key(20260101)


@pytest.fixture
def rng():
    return np.random.default_rng(20260101)


@pytest.fixture(scope="session")
def shared():
    """The folder of recorded heads and published metric values, beside the project."""
    folder = os.path.join(os.path.dirname(__file__), "..", "..", "shared")
    if not os.path.isdir(os.path.join(folder, "traces")):
        pytest.skip("no recorded traces beside the project")
    return os.path.abspath(folder)
