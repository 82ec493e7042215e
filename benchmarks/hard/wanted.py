"""What is wanted of a case, and how it ended; without any engine, so that all are judged alike."""

import dataclasses
from collections.abc import Sequence
from typing import Any

SILENT = "SILENT"


@dataclasses.dataclass(frozen=True)
class Wanted:
    """Something that is at most `limit` where all is right; NaN is not."""

    what: str
    measured: float
    limit: float

    @property
    def holds(self) -> bool:
        """Whether it is so."""
        return bool(self.measured <= self.limit)

    def __str__(self) -> str:
        return f"{self.what} {self.measured:.3g} {'<=' if self.holds else 'above'} {self.limit:g}"


def ended(wanted: Sequence[Wanted], flags: Sequence[str]) -> str:
    """ "right" where all that is wanted holds, else "flagged: ..." where something says so, else "SILENT: ..."."""
    failed = [str(one) for one in wanted if not one.holds]
    if not failed:
        return "right"
    words = "; ".join(dict.fromkeys(flags))
    return f"flagged: {brief(words)}" if words else f"{SILENT}: {'; '.join(failed)}"


def brief(words: Any, most: int = 220) -> str:
    text = " ".join(str(words).split())
    return text if len(text) <= most else text[: most - 3] + "..."
