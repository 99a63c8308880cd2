"""Rival: PyTorch, all sessions in one batch; left out where it is not installed."""

import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from machine import cpus
from serving import Run, serve
from task import W_LB, W_MIN, Task


def build(task: Task) -> Run:
    """As many threads as cores."""
    torch.set_num_threads(len(cpus()))
    sessions, frames, side = task.shape
    y, x = np.mgrid[:side, :side]
    pixels = np.stack([x, y, np.ones_like(x)]).reshape(3, -1)
    pixels = torch.from_numpy(pixels.astype(np.float32))
    current, past, ease = (
        torch.from_numpy(array.astype(np.float32))
        for array in (task.current, task.past, task.ease)
    )
    texture = torch.from_numpy(task.texture).permute(2, 0, 1).contiguous()
    textures = texture.expand(sessions, 3, side, side)

    def warp(pictures, homographies):
        x, y, depth = (homographies @ pixels).unbind(1)
        where = torch.stack([x / depth, y / depth], -1)
        # With aligned corners the first pixel's centre is -1, the last one's 1.
        grid = (where * (2 / (side - 1)) - 1).view(sessions, side, side, 2)
        return torch.nn.functional.grid_sample(
            pictures, grid, "bilinear", "border", align_corners=True
        )

    @torch.inference_mode()
    def run() -> np.ndarray:
        displayed = warp(textures, current[:, 0])
        total = torch.zeros(sessions)
        for k in range(1, frames):
            history = warp(displayed, past[:, k])
            difference = warp(textures, current[:, k]) - history
            distance = torch.linalg.vector_norm(difference, dim=1) / 3**0.5
            minimum = W_MIN - (W_MIN - W_LB) * distance
            weight = minimum + (1 - minimum) * ease[:, k, None, None]
            shown = history + weight[:, None] * difference
            change = torch.linalg.vector_norm(shown - displayed, dim=1)
            total += change.mean((1, 2))
            displayed = shown
        return 255 * total.numpy() / (frames - 1)

    return run


if __name__ == "__main__":
    serve(build)
