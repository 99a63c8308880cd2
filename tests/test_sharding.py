"""How many devices share the sessions changes no bit of what is measured."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hmdjit.simulation import sharding as devices

TESTS = os.path.dirname(__file__)
PROGRAM = """
import sys
import jax
jax.config.update("jax_num_cpu_devices", int(sys.argv[1]))
sys.path.append(sys.argv[3])
import small
import hmdjit as hj
from hmdjit.studies.measured_blocks import Tiles
study = hj.Study(
    scenes={"noise": hj.scenes.power_law_noise(), "solids": small.solids()},
    techniques=(hj.techniques.NoAntialiasing(), hj.techniques.HeadMovement()),
    head=hj.HeadMotion.fixating(),
    camera=hj.Camera(64, 64, 8.0, 60.0),
    measure=Tiles(2, 16),
    baseline="none",
    sessions=7,
    frames=3,
    warmup=2,
)
data = study.run(0, batch_size=int(sys.argv[2]))
print(data["mtcd"].values.tobytes().hex(), data["detail_loss"].values.tobytes().hex())
"""


@pytest.mark.slow
def test_devices_and_batches_change_no_bit():
    def run(count, batch):
        command = [sys.executable, "-c", PROGRAM, str(count), str(batch), TESTS]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        return done.stdout

    assert len({run(1, 7), run(2, 7), run(3, 7), run(2, 3)}) == 1


def test_items_are_mapped_with_what_they_share():
    count = 4 * len(jax.devices())
    items = jnp.arange(float(count))
    found = devices.over_devices(lambda a, x: a * x, 3.0, items, devices.mesh())
    np.testing.assert_array_equal(found, 3.0 * np.arange(count))
