"""What a study's numbers rest on: versions, machine, camera, head, frames and seed.

Files carry it as attributes, figures and tables say it in words.
"""

import dataclasses
import math
import platform
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from .. import camera as pinhole
from .._version import __version__
from ..camera import Camera
from ..frames.sources import AbstractSource
from ..head_motion import HeadMotion, presets
from ..techniques import SSAA
from .definition import StudyDefinition
from .sessions import Head
from .store import fingerprint

if TYPE_CHECKING:
    import xarray

MODEL_VERSION = "5"
"""Which numbers a study gives; changing any default that moves them changes this."""

_OLD_METRICS = ("mtcd", "detail_loss")  # of files that do not name theirs


SETTINGS = ("jax_enable_x64", "jax_default_matmul_precision")
"""What moves numbers, but no draws; see `sessions`."""


def numbers_key(study: StudyDefinition, seed: int) -> str:
    """Hash what decides the numbers of all scenes and techniques alike, here."""
    return fingerprint(
        [MODEL_VERSION, jax.__version__, jax.devices()[0].device_kind, seed],
        [str(getattr(jax.config, name)) for name in SETTINGS],
        [study.display, study.head, study.frames, study.warmup, study.measure],
        [study.oversampling, float(study.margin_deg), study.metrics],
    )


def attributes(
    study: StudyDefinition, seed: int, config_hash: str = ""
) -> dict[str, Any]:
    """Identify a study's numbers: a dataset's attributes, but for how its run went."""
    camera = study.display
    size = np.array([camera.width_px, camera.height_px], np.float32)
    centre, side = size / 2, size * np.array([1, 0.5], np.float32)
    along_yaw = lambda place: float(pinhole.px_per_deg(camera, jnp.asarray(place))[0])
    return {
        "title": "What simulated viewing sessions measured",
        "hmdjit_version": __version__,
        "model_version": MODEL_VERSION,
        "config_hash": config_hash,
        "seed": seed,
        "baseline": study.baseline,
        "reference": SSAA().id,
        "frames": study.frames,
        "warmup": study.warmup,
        "measure": str(study.measure),
        "head": head_words(study.head),
        "head_model": model_words(study.head),
        **_head_fit(study.head),
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "fov_deg": float(camera.fov_deg),
        "refresh_hz": float(camera.refresh_hz),
        "px_per_deg_centre": along_yaw(centre),
        "px_per_deg_side": along_yaw(side),
        "px_per_deg_mean": mean_px_per_deg(camera),
        "oversampling": study.oversampling,
        "margin_deg": float(study.margin_deg),
        **_solids(study),
        "dtype": "float32",
        "device": f"{len(jax.devices())} x {jax.devices()[0].device_kind}",
        "machine": platform.machine(),
        "python_version": platform.python_version(),
        "jax_version": jax.__version__,
        "numpy_version": np.__version__,
    }


def definition(study: StudyDefinition, seed: int, goal: object) -> dict[str, str]:
    """Return what decides a study's numbers: names to short hashes of their values."""
    fields = [field.name for field in dataclasses.fields(StudyDefinition)]
    parts = {name: getattr(study, name) for name in fields}
    scenes, techniques = parts.pop("scenes"), parts.pop("techniques")
    del parts["sessions"], parts["shapes"]
    parts["margin_deg"] = float(study.margin_deg)  # 6 is 6.0
    parts |= {"seed": seed, "tolerance or budget": goal, "model version": MODEL_VERSION}
    parts |= {f"scene {name}": scene for name, scene in scenes.items()}
    parts |= {f"technique {technique.id}": technique for technique in techniques}
    return {name: fingerprint(part)[:16] for name, part in parts.items()}


def _solids(study: StudyDefinition) -> dict[str, Any]:
    """Say what numbers of solids rest on, where there are any."""
    names = [n for n, s in study.scenes.items() if isinstance(s, AbstractSource)]
    if not names:
        return {}
    neck, head = study.neck, study.head
    words = "none" if neck is None else f"{float(neck.up_m):g} m up, "
    words += "" if neck is None else f"{float(neck.forward_m):g} m forward"
    if not isinstance(head, HeadMotion) and head.has_places:
        words = "none, for the eye's place is recorded"
    return {
        "solids": names,
        "neck": words,
        "reference_samples": study.reference_samples,
        "reference_every": study.reference_every,
    }


def _solids_words(known: Mapping[str, Any]) -> str:
    if "solids" not in known:
        return ""
    every = int(known["reference_every"])
    frames = "each measured frame" if every == 1 else f"1 of {every} measured frames"
    return (
        f"Solids ({', '.join(np.atleast_1d(known['solids']))}): neck "
        f"{known['neck']}; detail loss to {known['reference_samples']} rays per pixel "
        f"on {frames}. "
    )


def _head_fit(head: Head) -> dict[str, Any]:
    """Say how sure a head model is: NaN where it is taken as known."""
    if not isinstance(head, HeadMotion):
        return {}
    if head.fit_error is None:
        return {"head_fit_error": math.nan}
    fit = dataclasses.asdict(head.fit_error)
    names = {"rotation": "error", "clusters": "clusters", "over": "over"}
    return {f"head_fit_{name}": fit[field] for field, name in names.items()}


def _head_words(known: Mapping[str, Any]) -> str:
    error = known.get("head_fit_error")
    if error is None:
        return ""
    if math.isnan(error):
        return ", taken as known: intervals are given this head"
    return (
        f", fitted to {known['head_fit_over']}: intervals include the error of how "
        f"much it turns, ± {100 * error:.1f} %, but not of how smoothly"
    )


def mean_px_per_deg(camera: Camera) -> float:
    """Picture motion per degree of yaw or pitch, averaged over the camera frame."""
    x = (np.arange(64) + 0.5) / 64 * camera.width_px
    y = (np.arange(64) + 0.5) / 64 * camera.height_px
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2).astype(np.float32)
    speeds = jax.vmap(lambda p: pinhole.px_per_deg(camera, p))(jnp.asarray(grid))
    return float(jnp.mean(speeds))


def metric_ids(dataset: "xarray.Dataset") -> list[str]:
    """Name a study's metrics, which are its variables; the first is the headline."""
    # A file gives a list of one back as a string.
    return [
        str(name) for name in np.atleast_1d(dataset.attrs.get("metrics", _OLD_METRICS))
    ]


def metric_words(metric: str) -> str:
    """Spell a metric's id as words: MTCD, detail loss."""
    acronyms = {"mtcd", "mse", "rmsd", "psnr", "snr", "ssim", "ciede2000"}
    words = metric.split("_")
    return " ".join(word.upper() if word in acronyms else word for word in words)


def made_by() -> str:
    """Name the version and the model that numbers come from."""
    return f"hmdjit {__version__}, model {MODEL_VERSION}"


def counted(number: int, noun: str) -> str:
    """Say how many there are of something."""
    return f"{number:,} {noun}" + "s" * (number != 1)


def head_words(head: Head) -> str:
    """Name a preset; say what another head is."""
    is_model = isinstance(head, HeadMotion)
    return (is_model and presets.name_of(head)) or model_words(head)


def model_words(head: Head) -> str:
    """Say what a head is, a preset too."""
    return presets.words(head) if isinstance(head, HeadMotion) else str(head)


def camera_words(known: Mapping[str, Any]) -> str:
    """Say a camera's resolution, field of view and refresh rate."""
    return (
        f"{known.get('width_px')} × {known.get('height_px')} px, "
        f"{_number(known, 'fov_deg')}° wide, {_number(known, 'refresh_hz')} Hz"
    )


def frames_words(known: Mapping[str, Any]) -> str:
    """Say how long sessions are, and their seed."""
    return (
        f"{known.get('frames')} frames after {known.get('warmup')} of warm-up, "
        f"seed {known.get('seed')}"
    )


def footer(dataset: "xarray.Dataset") -> str:
    """Say what a picture or table of a study depends on, in a few sentences."""
    known, count = dataset.attrs, dataset.sizes["session"]
    sessions = counted(count, "session")
    if (
        "control_slope" in dataset
    ):  # a study with a goal runs as many as each scene needs
        sessions = f"Up to {sessions} per scene"
    return (
        f"Camera {camera_words(known)}: "
        f"{_number(known, 'px_per_deg_centre')} px/deg in the centre, "
        f"{_number(known, 'px_per_deg_side')} at the side, "
        f"{_number(known, 'px_per_deg_mean')} on average; "
        f"{known.get('measure', 'unknown part')} measured. "
        f"Head: {known.get('head', 'unknown')}{_head_words(known)}. "
        f"{_solids_words(known)}{sessions} of {frames_words(known)}; "
        f"hmdjit {known.get('hmdjit_version')}, model {known.get('model_version')}, "
        f"config {str(known.get('config_hash'))[:8]}."
    )


def _number(known: Mapping[str, Any], name: str) -> str:
    return f"{float(known[name]):.4g}" if name in known else "?"
