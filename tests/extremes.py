"""Techniques and head paths at the ends of their numbers."""

import jax
import jax.numpy as jnp
import numpy as np

from hmdjit import quaternion
from hmdjit.techniques import SSAA, HeadMovement


def techniques():
    """Head movement with its numbers at their ends; one structure each."""
    numbers = [
        *({}, {"w_min": 0.0, "w_lb": 0.0}, {"w_min": 1.0, "w_lb": 1.0}),
        *({"w_min": 1.0, "w_lb": 0.0}, {"w_min": 0.3, "w_lb": 0.3}),
        *({"h_max_deg_s": 1e-20}, {"h_max_deg_s": 1e20}, {"h_max_deg_s": 1e-6}),
        *({"closeness": (0.0,)}, {"closeness": (1.0,)}, {"closeness": (1e-8,)}),
    ]
    rising = tuple(np.linspace(0, 1, 16).tolist())
    return {
        "one past sample": [HeadMovement(**kinds) for kinds in numbers],
        "sixteen": [
            HeadMovement(closeness=d) for d in ((2 / 3,) * 16, rising, (0.0,) * 16)
        ],
        "weights": [HeadMovement(closeness=(0.2, 0.7), weights=(1.0, 0.0))],
        "largest channel": [HeadMovement(difference="max_channel")],
        "same pixel": [HeadMovement(difference="same_pixel")],
        "linear light": [HeadMovement(space="linear")],
        "over SSAA": [HeadMovement(resolve=SSAA(2))],
    }


def cast(tree, dtype):
    """The same numbers in a dtype."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), tree)


def bad_leaves(tree):
    """How many numbers of a pytree are not finite."""
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]
    return int(sum(np.sum(~np.isfinite(leaf)) for leaf in leaves))


def poses_of_turn(turn_rad):
    """Two equal turns after the hold pose, about yaw and a little pitch."""
    step = quaternion.exp(jnp.stack([part * turn_rad for part in (0.1, 1.0, 0.0)]))
    first = jnp.zeros_like(step).at[0].set(1.0)
    return jnp.stack([first, step, quaternion.multiply(step, step)])


def wandering_poses(rng, frames, turn_rad):
    """Poses of a head that wanders within some 20 turns, float64 NumPy."""
    turns = turn_rad * rng.normal(size=(frames, 3))
    turns[0] = 0.0
    for k in range(1, frames):
        turns[k] += 0.995 * turns[k - 1]
    return np.asarray(jax.vmap(quaternion.exp)(jnp.asarray(turns.clip(-0.06, 0.06))))
