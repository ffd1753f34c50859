"""What a search over quadratic programs may spend: so many of them, and so much time."""

from __future__ import annotations

from collections.abc import Callable


class Budget:
    """Counts the quadratic programs that may still be solved."""

    def __init__(self, most: int, expired: Callable[[], bool]):
        """Start with nothing spent.

        Args:
            most: Programs that may be solved.
            expired: Asked before each; True when time is over.
        """
        self.spent = 0
        self._most = most
        self._expired = expired

    def spend(self) -> bool:
        """Take one; False when nothing is left."""
        if self.is_over:
            return False
        self.spent += 1
        return True

    @property
    def is_over(self) -> bool:
        """Whether nothing is left."""
        return self.spent >= self._most or self._expired()
