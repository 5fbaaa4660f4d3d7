"""The refined navigation of a survey: rows and document."""

from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.instrument import UNKNOWNS
from sionna_radar.mapping.navigation.refinement import RefinedNavigation
from sionna_radar.survey.navigation import WayError, in_words

MEANING = (
    "errors of the navigation, estimated from the echoes (processing.navigation = 'refined'): of each its standard "
    "deviations as stated and after the flight, RMS over the pulses, and whether the echoes tell it; way: RMS errors "
    "of the antenna's place and of its axes with the reported and the refined poses, and the share of pulses within "
    "the intervals of 68 and 95 %, where the truth is known; null for reported navigation"
)


def navigation_document(navigation: RefinedNavigation, way: WayError | None) -> dict[str, Any]:
    """Return the refined navigation as the summary holds it."""
    rows = zip(navigation.names, _rms(navigation.before), _rms(navigation.sigma), navigation.observable, strict=True)
    errors = {
        f"{in_words(name)} ({UNKNOWNS[name].unit})": {
            "stated": stated / UNKNOWNS[name].si,
            "sigma": sigma / UNKNOWNS[name].si,
            "observable": bool(observable),
        }
        for name, stated, sigma, observable in rows
    }
    return {
        "errors": errors,
        "reduced_chi2": navigation.reduced_chi2,
        "used": navigation.holds,
        "way": None if way is None else way.document(),
    }


def navigation_rows(navigation: RefinedNavigation | None, way: WayError | None) -> dict[str, str]:
    """Return the refined navigation in the table of a survey on the console."""
    if navigation is None or not navigation.holds:
        return {}
    if way is None:
        told = [in_words(n) for n, known in zip(navigation.names, navigation.observable, strict=True) if known]
        return {"navigation refined": f"the echoes tell {', '.join(told) or 'none of its errors'}"}
    (before, after), (pointing, refined) = way.place_m, way.pointing_deg
    place = f"place {np.linalg.norm(before):.3g} to {np.linalg.norm(after):.3g} m RMS"
    axes = f"axes {pointing:.2g} to {refined:.2g} deg RMS"
    return {"navigation refined": ", ".join([place] * bool(before.any()) + [axes] * (pointing > 0))}


def _rms(values: Float[np.ndarray, "pulse error"]) -> Float[np.ndarray, " error"]:
    return np.sqrt(np.mean(values**2, axis=0))
