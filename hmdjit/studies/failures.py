"""Sessions that give no finite number, and what a study does about them."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

MOST_FAILED = 0.01
"""Share of the sessions; a study in which more than that fail is always stopped."""


class FailedSessionsError(RuntimeError):
    """Sessions gave no finite number."""


class LostWorkersError(RuntimeError):
    """Workers that batches were given to have died, again and again."""


@dataclasses.dataclass(frozen=True)
class Failures:
    """What a study does about sessions that give no finite number.

    - `omit`: leave them out, if they are few, instead of stopping.
    - `margin_deg`: how far a head may turn, for one cause is a head that turns farther.
    - `kept_in`: where finished batches are, or None.
    """

    omit: bool
    margin_deg: float
    kept_in: Path | None

    def check(self, failed: Sequence[int], count: int, what: str = "sessions") -> None:
        """Stop the study unless the sessions that failed may be left out.

        **Arguments:** `failed`: their numbers; `count`: of all of them; `what`: they
        are, in words.

        **Errors:** `FailedSessionsError`.
        """
        is_few = len(failed) <= MOST_FAILED * count
        if not failed or (self.omit and is_few):
            return
        named = ", ".join(map(str, failed[:10])) + (", ..." if len(failed) > 10 else "")
        choice = (
            "omit_failed=True leaves them out"
            if is_few
            else f"at most {MOST_FAILED:.0%} may, with omit_failed=True"
        )
        kept = f" Finished batches are kept in {self.kept_in}." if self.kept_in else ""
        raise FailedSessionsError(
            f"{len(failed)} of {count} {what} gave no finite number ({named}); "
            f"{choice}. One cause is a head that turns more than margin_deg = "
            f"{self.margin_deg:g} from where it started.{kept}"
        )
