"""
A published mapper beside this chain: AVTIS2
============================================

AVTIS2 maps volcanoes and glaciers at 94 GHz with a beam of 0.35 to 0.5 deg; its points lie within about 1.5 m at 1.5 km
and 3 m at 3 km (arXiv 2310.08120). The preset flies over hills of Texas (SRTM, 75 m between heights, which come with
matplotlib), and the points that it finds are set against the ground that was flown over.
"""

import numpy as np
from scipy.stats import cauchy, norm

from sionna_radar import load_scenario, run

INCIDENCE_DEG, TRACKS = 60.0, ((-3000.0, 0.0), (0.0, 3000.0), (0.0, -3000.0))


def flown(altitude_m, beam_deg, ranging, start_m, length_m, samples=16384, gate_us=0.0):
    return run(
        load_scenario(
            "hills",
            {
                "terrain": {"kind": "jacksboro", "spacing_m": 20.0},
                "platform": {
                    "altitude_m": altitude_m,
                    "start_m": start_m,
                    "speed_mps": 1.0,
                    "length_m": length_m,
                    "heading_deg": 90.0,
                },
                "radar": {
                    "preset": "avtis2",
                    "samples_per_chirp": samples,
                    "gate_delay_us": gate_us,
                    "antenna": {"kind": "taylor", "beamwidth_deg": beam_deg, "side_lobe_db": -25.0},
                    "scan": {
                        "mode": "whisk_broom",
                        "incidence_deg": INCIDENCE_DEG,
                        "half_swath_deg": 20.0,
                        "rotation_rpm": 20.0,
                    },
                },
                "processing.ranging": ranging,
                "dem": {"spacing_m": 20.0, "method": "linear"},
            },
        )
    )


def errors_m(survey):
    """Return how far the points lie off the ground: along the beam, and vertically."""
    points, caster = survey.points, survey.prepared.world.caster
    along = (points.position_m - points.origin_m) / points.range_m[:, None]
    beyond = points.range_m - caster.cast(points.origin_m, along).distance_m
    above = points.position_m[:, 2] - caster.from_above(points.position_m[:, :2], 5000.0)
    return beyond, above


def nmad(values):
    return 1.4826 * np.median(np.abs(values - np.median(values)))


def flown_at(range_m, *radar, **sampled):
    """Return the errors and ranges of all tracks, each at the height from which its ground is this far away."""
    found = []
    for start_m in TRACKS:
        altitude_m = range_m * np.cos(np.deg2rad(INCIDENCE_DEG))
        for _ in range(4):
            reached = float(np.median(flown(altitude_m, radar[0], "centroid", start_m, 3.0).points.range_m))
            altitude_m = max(altitude_m + (range_m - reached) * np.cos(np.deg2rad(INCIDENCE_DEG)), 60.0)
        found.append(flown(altitude_m, *radar, start_m, 30.0, **sampled))
    beyond, above = (np.concatenate(part) for part in zip(*map(errors_m, found), strict=True))
    usual = np.isfinite(beyond) & np.isfinite(above)
    return np.concatenate([survey.points.range_m for survey in found]), beyond[usual], above[usual]


def row(ranges, beam_deg, ranging, beyond, above):
    return (
        f"{np.median(ranges):.0f} m | {beam_deg} deg | {ranging} | {len(above)} | {np.median(beyond):+.2f} | "
        f"{nmad(beyond):.2f} | {nmad(above):.2f} | {np.sqrt(np.mean(above**2)):.2f}"
    )


# %%
# The height over each start is chosen for the range: the ground of a beam at 60 deg is far from that below.
# The last column is the logarithm of the likelihood of a Lorentz distribution of heights over that of a normal one.
print("range | beam | ranging | points | bias of range | NMAD of range | NMAD of height | RMS of height | Lorentz")
for range_m in (1500.0, 3000.0):
    for radar in ((0.35, "centroid"), (0.35, "peak"), (0.5, "centroid"), (0.5, "peak")):
        ranges, beyond, above = flown_at(range_m, *radar)
        lorentz = cauchy.logpdf(above, *cauchy.fit(above)).sum() - norm.logpdf(above, *norm.fit(above)).sum()
        print(f"{row(ranges, *radar, beyond, above)} | {lorentz:+.0f}")

# %%
# A range gate takes the samples up to 2.1 km out: a quarter of them reaches from there to 3.6 km.
print("behind a gate of 14 us, 4,096 samples a sweep")
for radar in ((0.35, "centroid"), (0.35, "peak")):
    ranges, beyond, above = flown_at(3000.0, *radar, samples=4096, gate_us=14.0)
    print(row(ranges, *radar, beyond, above))
