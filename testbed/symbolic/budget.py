"""How long equations may become: refused before they take all time and memory."""

from __future__ import annotations

from testbed.errors import ExpressionError

MAX_TERMS = 150_000
"""Terms that take some ten seconds to write, and that nobody reads."""
PRODUCT = 0.1
"""What multiplying two terms counts: most products are added up to fewer terms."""


class Budget:
    """Counts terms while equations are written or read.

    Attributes:
        terms: How many there may be.
        spent: How many there were so far.
    """

    def __init__(self, terms: int = MAX_TERMS, shorter: str = "") -> None:
        """Nothing spent yet.

        Args:
            terms: How many there may be.
            shorter: What to ask for instead, if anything.
        """
        self.terms = terms
        self.spent = 0.0
        self._shorter = shorter

    def write(self, terms: int) -> None:
        """Count terms that are written down.

        Raises:
            ExpressionError: There are too many.
        """
        self.spent += terms
        if self.spent > self.terms:
            raise ExpressionError(
                f"this takes more than {self.terms} terms, those on the way included: "
                f"{self._shorter}--max-terms N (max_terms=N) allows more, at the price of time "
                "and memory"
            )

    def multiply(self, products: int) -> None:
        """Count products of terms, before they are made.

        Raises:
            ExpressionError: There are too many.
        """
        self.spent += PRODUCT * products
        self.write(0)
