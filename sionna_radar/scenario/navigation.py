"""What the navigation system gets wrong: `[platform.navigation]`."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from sionna_radar.scenario.bases import NavigationParameters, Offset
from sionna_radar.scenario.table import NonNegative, Positive

Spread = Annotated[NonNegative, Field(le=1e4)]
Axes = Offset | tuple[Offset, Offset, Offset]
SpreadAxes = Spread | tuple[Spread, Spread, Spread]


class LoggedErrorsTable(NavigationParameters):
    """Errors as large as the log of the flight states: `navigation = "from_log"`.

    Standard deviations come from the covariance of the log's filter, or else from its innovations; what errs in the
    flight is a first-order Gauss-Markov process of that size, drawn from the seed. A part of the pose that the
    log says nothing of is known exactly.

    correlation_s: correlation times of position, velocity and attitude; those of `NavigationTable`.
    """

    kind: Literal["from_log"] = "from_log"
    correlation_s: tuple[Positive, Positive, Positive] = (60.0, 10.0, 60.0)


class NavigationTable(NavigationParameters):
    """Errors of the measured pose; one number for all three axes, or one for each.

    Position and velocity count east, north, up; attitude counts roll, pitch, heading. A part named markov is a
    first-order Gauss-Markov process with a correlation time. The lever arm leads from the navigation system to
    the antenna (nose, right, down) and is believed to be longer by its error; the mount of the antenna is
    believed to be turned by boresight_error_deg about the same axes.

    position_constant_m: constant error of the position.
    position_white_m: standard deviation from chirp to chirp.
    position_markov_m: standard deviation of its Gauss-Markov part.
    position_correlation_s: correlation time of that part.
    velocity_constant_mps: constant error of the velocity.
    velocity_white_mps: standard deviation from chirp to chirp.
    velocity_markov_mps: standard deviation of its Gauss-Markov part.
    velocity_correlation_s: correlation time of that part.
    attitude_constant_deg: constant error of the attitude.
    attitude_white_deg: standard deviation from chirp to chirp.
    attitude_markov_deg: standard deviation of its Gauss-Markov part.
    attitude_correlation_s: correlation time of that part.
    time_offset_s: lag of the report behind the radar's clock.
    lever_arm_error_m: nose, right, down.
    boresight_error_deg: about the nose, right and down axes.
    """

    kind: Literal["errors"] = "errors"
    position_constant_m: Axes = 0.0
    position_white_m: SpreadAxes = 0.0
    position_markov_m: SpreadAxes = 0.0
    position_correlation_s: Positive = 60.0
    velocity_constant_mps: Axes = 0.0
    velocity_white_mps: SpreadAxes = 0.0
    velocity_markov_mps: SpreadAxes = 0.0
    velocity_correlation_s: Positive = 10.0
    attitude_constant_deg: Axes = 0.0
    attitude_white_deg: SpreadAxes = 0.0
    attitude_markov_deg: SpreadAxes = 0.0
    attitude_correlation_s: Positive = 60.0
    time_offset_s: Offset = 0.0
    lever_arm_error_m: Axes = 0.0
    boresight_error_deg: Axes = 0.0

    @property
    def has_errors(self) -> bool:
        """Whether the measured pose differs from the true one."""
        harmless = {"kind", "lever_arm_m"} | {
            name for name in type(self).model_fields if name.endswith("_correlation_s")
        }
        values = (getattr(self, name) for name in type(self).model_fields if name not in harmless)
        return any(np.any(np.asarray(value) != 0) for value in values)
