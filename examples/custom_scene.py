"""A scene of one's own: a plain function of a place, in degrees, gives its colour.

    python examples/custom_scene.py

printed

    none          MTCD 16.55 code values, detail loss 474.5
    head_movement MTCD  8.74 code values, detail loss 443.7
    ssaa2         MTCD 15.00 code values, detail loss 219.4

and these do more with it:

    hmdjit render examples/custom_scene.py:scene
    hmdjit study --scenes text examples/custom_scene.py:scene
"""

import argparse

import jax
import jax.numpy as jnp

import hmdjit as hj


def louvres(x: jax.Array, y: jax.Array) -> list[jax.Array]:
    """Slats that grow thinner to the top, before a sky; gamma red, green, blue.

    **Arguments:** right and up of straight ahead, degrees at the centre of the view.
    """
    tilted = y + 0.07 * x
    per_deg = 0.3 + 0.02 * (y + 60)  # slats
    is_slat = jnp.mod(tilted * per_deg, 1) < 0.6
    sky = [0.55 + 0.003 * y, 0.7 + 0.002 * y, 0.9 + 0 * y]
    wood = [0.45 + 0 * x, 0.3 + 0 * x, 0.2 + 0 * x]
    pairs = zip(wood, sky, strict=True)
    return [jnp.clip(jnp.where(is_slat, w, s), 0, 1) for w, s in pairs]


setattr(louvres, "version", 1)  # noqa: B010  studies keep finished batches of it


def scene() -> hj.scenes.AbstractScene:
    """Return what `--scenes examples/custom_scene.py:scene` shows."""
    return hj.scenes.from_function(louvres)


def main() -> None:
    """Compare techniques in front of it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--sessions", type=int, default=100)
    sessions = parser.parse_args().sessions
    compared = [*map(hj.techniques.by_id, ("none", "head_movement", "ssaa2"))]
    scenes, head = {"louvres": scene()}, hj.HeadMotion.fixating()
    study = hj.Study(scenes, compared, head=head, sessions=sessions, baseline="none")
    data = study.run(seed=0).mean(["session", "scene"])
    for id in data["technique"].values:
        mtcd, loss = (float(data[m].sel(technique=id)) for m in ("mtcd", "detail_loss"))
        print(f"{id:13} MTCD {mtcd:5.2f} code values, detail loss {loss:.1f}")


if __name__ == "__main__":
    main()
