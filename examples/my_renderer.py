"""Frames of a renderer of one's own: any that can be told where the head looks.

The renderer here is twelve lines of NumPy, a room of checks around the head. What it
renders with the poses of a log goes to `hj.apply`, which displays it by a technique.

    python examples/my_renderer.py

printed

    90 frames as rendered: 0.61 code values
    displayed with w_min 0.3: 0.55
    displayed with w_min 0.1: 0.46

Frames and poses on disk are read by `hmdjit apply head_movement FRAMES_DIR POSES.csv`.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import hmdjit as hj

LOG = Path(__file__).parents[1] / "traces" / "seated_90hz.csv"


def render(camera: hj.Camera, world_from_head: np.ndarray) -> np.ndarray:
    """Gamma picture of one pose, `(height, width, 3)`; axes as OpenXR: -z forward."""
    x, y = np.meshgrid(
        np.arange(camera.width_px) + 0.5 - camera.width_px / 2,
        camera.height_px / 2 - np.arange(camera.height_px) - 0.5,
    )
    ray = np.stack([x, y, np.full_like(x, -float(camera.focal_px))], axis=-1)
    turned = Rotation.from_quat(world_from_head, scalar_first=True).apply(
        ray.reshape(-1, 3)
    )
    on_cube = turned / np.abs(turned).max(axis=1, keepdims=True)  # a room of 2 m
    checks = np.floor(8 * on_cube + 1e-9).sum(axis=1) % 2
    grey = (0.2 + 0.6 * checks).reshape(x.shape)
    return np.repeat(grey[..., None], 3, axis=-1).astype(np.float32)


def main() -> None:
    """Render a log, display it by techniques, and print how much each flickers."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--frames", type=int, default=90)
    trace = hj.Trace.read(LOG)
    poses = trace.world_from_head[: parser.parse_args().frames]
    camera = hj.Camera(160, 120, fov_deg=40.0, refresh_hz=trace.rate_hz)
    frames = np.stack([render(camera, pose) for pose in poses])
    mtcd = float(hj.metrics.mtcd(frames))
    print(f"{len(frames)} frames as rendered: {mtcd:.2f} code values")
    for least in (0.3, 0.1):  # weight of the current picture of a head at rest
        technique = hj.techniques.HeadMovement(w_min=least)
        shown = hj.apply(technique, camera, frames, poses)
        print(f"displayed with w_min {least}: {float(hj.metrics.mtcd(shown)):.2f}")


if __name__ == "__main__":
    main()
