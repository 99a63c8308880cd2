"""Would quasi-random head paths be surer? Variance of predicted means, Sobol or not.

A path of 22 frames is a sum of its covariance's eigenmodes, largest first. Person, tile
and leading modes come from scrambled Sobol points or from random numbers, everything
else from random numbers; MTCD is the small-motion theory's. Printed per scene: by how
much Sobol points divide the variance of a mean over 1,024 paths, from independent
replicates, with the 95 % interval of that. Without bursts.

    python examples/quasi_random_paths.py --scenes coffee text checkerboard
"""

import argparse

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

import hmdjit as hj
from hmdjit.theory import prediction as theory
from hmdjit.theory.picture_statistics import PictureStatistics

FRAMES, WARMUP, PATHS, REPLICATES, MODES = 22, 12, 1024, 48, 9
CELL_PX = 64


def modes(head: hj.HeadMotion, rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Eigenmodes of a person's path, `(66, frames, 3)`; the tracker's noise; deg."""
    lags = np.arange(FRAMES)
    turned = np.asarray(head.structure_function(lags / rate_hz), float)
    between = np.abs(lags[:, None] - lags)
    covariance = (turned[:, None] + turned[None] - turned[between]) / 2
    own = np.zeros((3 * FRAMES, FRAMES, 3))
    size = np.zeros(3 * FRAMES)
    for axis in range(3):
        power, vectors = np.linalg.eigh(covariance[..., axis])
        part = slice(axis * FRAMES, (axis + 1) * FRAMES)
        own[part, :, axis] = (np.sqrt(np.maximum(power, 0)) * vectors).T
        size[part] = power
    return own[np.argsort(-size)], np.array(head.tracker_noise_deg, float)


def drawn(rng: np.random.Generator, *, sobol: bool) -> tuple[np.ndarray, np.ndarray]:
    """Uniforms for person and tile, normals for the modes."""
    count = 3 + MODES
    if sobol:
        uniform = qmc.Sobol(count, rng=rng).random(PATHS)
    else:
        uniform = rng.random((PATHS, count))
    uniform = np.clip(uniform, 1e-12, 1 - 1e-12)
    rest = rng.normal(size=(PATHS, 3 * FRAMES - MODES))
    return uniform[:, :3], np.concatenate([stats.norm.ppf(uniform[:, 3:]), rest], 1)


def main() -> None:
    """Predict replicates and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=["coffee"])
    options = parser.parse_args()
    camera, head = hj.Camera(), hj.HeadMotion.fixating()
    own, noise_deg = modes(head, float(camera.refresh_hz))
    columns, rows = camera.width_px // CELL_PX, camera.height_px // CELL_PX
    techniques = (hj.techniques.NoAntialiasing(), hj.techniques.HeadMovement())

    @jax.jit
    def means(statistics, motions, cells) -> list[jax.Array]:
        def of(technique) -> jax.Array:
            one = lambda both: theory.predict(
                statistics, camera, technique, both[0], warmup=WARMUP, cells=both[1]
            )
            return jnp.mean(jax.lax.map(one, (motions, cells[:, None])))

        return [of(technique) for technique in techniques]

    def replicate(statistics, rng: np.random.Generator, *, sobol: bool) -> list[float]:
        uniform, normal = drawn(rng, sobol=sobol)
        scale = np.exp(head.person_sd * stats.norm.ppf(uniform[:, 0]))
        turns = scale[:, None, None] * np.einsum("pm,mfa->pfa", normal, own)
        turns += noise_deg * rng.normal(size=turns.shape)
        flat = np.radians(turns - turns[:, :1]).reshape(-1, 3)
        poses = Rotation.from_rotvec(flat).as_quat(scalar_first=True)
        paths = poses.reshape(PATHS, FRAMES, 4)
        motion = jax.vmap(hj.Motion.of)(jnp.asarray(paths, jnp.float32))
        column, row = (uniform[:, 1:] * [columns, rows]).astype(int).T
        cells = jnp.asarray(columns * row + column, jnp.int32)
        return [float(mean) for mean in means(statistics, motion, cells)]

    print("scene, technique, variance at random / with Sobol points [95 %]")
    low, high = stats.f.ppf([0.025, 0.975], REPLICATES - 1, REPLICATES - 1)
    for name in options.scenes:
        texture = hj.scenes.bake(hj.scenes.study_set()[name], camera)
        statistics = PictureStatistics.of(texture, camera, cell_px=CELL_PX)
        spread = []
        for sobol in (False, True):
            rngs = np.random.default_rng(int(sobol)).spawn(REPLICATES)
            found = [replicate(statistics, rng, sobol=sobol) for rng in rngs]
            spread.append(np.var(found, axis=0, ddof=1))
        for technique, gain in zip(techniques, spread[0] / spread[1], strict=True):
            print(
                f"{name}, {technique.id}, {gain:.1f} "
                f"[{gain / high:.1f}, {gain / low:.1f}]",
                flush=True,
            )


if __name__ == "__main__":
    main()
