"""What is flown, in words, for the head of a page."""

import numpy as np

from sionna_radar.survey.preparation import Prepared


def flown_rows(prepared: Prepared) -> dict[str, str]:
    """Return the main settings of a survey by their names."""
    scenario, chirp, grid = prepared.scenario, prepared.receiver.chirp, prepared.mapper.grid
    start, end = prepared.flight.trajectory.cruise_s()
    rows = {
        "Ground": scenario.terrain.kind,
        "Things on it": _things(prepared),
        "Weather": scenario.weather.falling or "clear",
        "Height above ground": f"{prepared.flown.altitude_m:.4g} m",
        "Speed": f"{prepared.flown.speed_mps:.4g} m/s",
        "Time in the air": f"{end - start:.1f} s, {len(prepared.flight):,} pulses",
        "Sensor": scenario.sensor,
        "Scan": _scan(prepared),
        "Beam at half power": "" if scenario.sensor == "lidar" else _beam(prepared),
    }
    if scenario.sensor == "radar":
        rows |= {
            "Carrier": f"{chirp.carrier_hz / 1e9:.5g} GHz",
            "Sweep": f"{chirp.bandwidth_hz / 1e6:.5g} MHz, {scenario.radar.sweep}",
            "Range cell, farthest": f"{chirp.range_resolution_m:.3g} m, {chirp.max_range_m:.4g} m",
            "Ranges": scenario.processing.ranging,
            "Noise": _noise(prepared),
        }
    rows |= {
        "Pulse rate": f"{scenario.radar.mean_rate_hz / scenario.processing.average.chirps:.4g} Hz",
        "Navigation": "pose known exactly" if prepared.flight.navigation is None else scenario.platform.navigation.kind,
        "Map": f"{prepared.mapper.name}, {grid.columns} x {grid.rows} cells of {grid.spacing_m:g} m",
        "Seed": str(scenario.seed),
    }
    return {name: value for name, value in rows.items() if value}


def _things(prepared: Prepared) -> str:
    scenario = prepared.scenario
    counts = {
        "buildings": len(scenario.buildings),
        "objects": len(scenario.objects),
        "files of footprints": len(scenario.footprints),
        "point targets": len(prepared.scene.scene.targets),
    }
    return ", ".join(f"{name}: {count:,}" for name, count in counts.items() if count)


def _scan(prepared: Prepared) -> str:
    tilt = np.rad2deg(prepared.flight.scan.incidence_rad)
    return f"{prepared.scenario.radar.scan.mode.replace('_', ' ')}, {tilt:.3g} deg from nadir"


def _beam(prepared: Prepared) -> str:
    azimuth, elevation = np.rad2deg(prepared.antenna.beamwidths_rad)
    steered = f", steered to {len(prepared.beams)} places" if prepared.beams else ""
    return f"{azimuth:.3g} x {elevation:.3g} deg{steered}"


def _noise(prepared: Prepared) -> str:
    radar = prepared.scenario.radar
    return f"{radar.system_noise_figure_db:.4g} dB figure" if radar.snr_db is None else f"SNR {radar.snr_db:g} dB"
