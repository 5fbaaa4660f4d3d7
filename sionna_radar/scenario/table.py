"""What every table of a scenario shares: numbers that are numbers, frozen models, and errors with a key."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

Real = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Real, Field(gt=0)]
NonNegative = Annotated[Real, Field(ge=0)]
Count = Annotated[int, Field(strict=True, ge=1)]
Seed = Annotated[int, Field(strict=True, ge=0, lt=2**63)]
Point2 = tuple[Real, Real]
Point3 = tuple[Real, Real, Real]


def refuse(field: str, message: str) -> PydanticCustomError:
    """Return the error of a check that spans fields, bound to the dotted key it names."""
    return PydanticCustomError("scenario", "{message}", {"message": message, "field": field})


class Table(BaseModel):
    """A table of the scenario: frozen, and no key passes unnoticed."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True)
