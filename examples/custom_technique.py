"""A technique of one's own: an exponential TAA, compared with others in one study.

The past, found from the head's rotation, is averaged exponentially. All techniques see
the same heads and the same tiles, so that their ratios are paired.

    python examples/custom_technique.py

printed

    technique      MTCD   ratio to none      detail loss
    none           9.49   1.000 [1.000, 1.000]     160.2
    head_movement  5.36   0.565 [0.552, 0.578]     205.5
    ssaa4          7.99   0.842 [0.840, 0.844]       0.0
    my_taa         6.12   0.645 [0.636, 0.653]     109.5

and so does, with more scenes and its figures:

    hmdjit study --techniques none head_movement examples/custom_technique.py:MyTAA
"""

import argparse

import jax.numpy as jnp

import hmdjit as hj
from hmdjit.estimates.summary import summarize
from hmdjit.frames.sources import History


class MyTAA(hj.techniques.AbstractTechnique):
    """Exponential average along the head's rotation.

    - `alpha`: weight of the current picture, in `(0, 1]`.
    """

    alpha: float = 0.2
    id = "my_taa"  # pyright: ignore
    version = 1  # changed with all of this, so that studies keep finished batches

    def init(self, frame: hj.Frame) -> History:
        """Start from the first picture; planes are `(3, height, width)`."""
        return History.of(frame.color[0])

    def step(
        self, state: History, frame: hj.Frame, motion: hj.Motion
    ) -> tuple[History, jnp.ndarray]:
        """Show the average, and keep it."""
        current = frame.color[0]
        source = frame.displacement(motion.increment)  # where each pixel was
        past = jnp.where(source.inside()[None], state.at(source), current)
        shown = past + self.alpha * (current - past)
        return History.of(shown), shown


def main() -> None:
    """Run the study, and print its means over both scenes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--sessions", type=int, default=100)
    sessions = parser.parse_args().sessions
    hj.techniques.check(MyTAA())  # the laws that every technique keeps
    compared = [*map(hj.techniques.by_id, ("none", "head_movement", "ssaa4")), MyTAA()]
    scenes = {name: hj.scenes.by_name(name) for name in ("noise", "text")}
    head = hj.HeadMotion.fixating()
    study = hj.Study(scenes, compared, head=head, sessions=sessions, baseline="none")
    data = study.run(seed=0)
    print("technique      MTCD   ratio to none      detail loss")
    for row in summarize(data):
        if row.scene == "all":
            ratio = f"{row.ratio:.3f} [{row.ratio_low:.3f}, {row.ratio_high:.3f}]"
            loss = float(data["detail_loss"].sel(technique=row.technique).mean())
            print(f"{row.technique:13} {row.mean:5.2f}   {ratio}  {loss:8.1f}")


if __name__ == "__main__":
    main()
