"""A measured ratio and the bound that it must keep."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """A measured ratio and the bound it must keep; None for one that is only told."""

    name: str
    value: float
    bound: float | None
    at_most: bool

    @property
    def kept(self) -> bool:
        """Whether the bound is kept."""
        return self.bound is None or (self.value <= self.bound) == self.at_most

    def __str__(self) -> str:
        if self.bound is None:
            return f"{self.name:62}{self.value:12,.2f}"
        word = "at most" if self.at_most else "at least"
        verdict = "ok" if self.kept else "MISSED"
        return f"{self.name:62}{self.value:12,.2f}   {word} {self.bound:,.2f}   {verdict}"
