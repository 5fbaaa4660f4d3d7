"""Writers of pattern files in every format that is read, of any antenna; apart from the readers."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from sionna_radar.radar.antenna import Antenna

STEP_DEG = 2.0


def sphere(antenna: Antenna, boresight: str = "z", step_deg: float = STEP_DEG) -> tuple[np.ndarray, ...]:
    """Return theta, phi (degrees) and the gain (dBi) of an antenna on a grid about a file's axes."""
    theta, phi = np.meshgrid(
        np.arange(0, 180 + step_deg / 2, step_deg), np.arange(0, 360 + step_deg / 2, step_deg), indexing="ij"
    )
    t, p = np.deg2rad([theta.ravel(), phi.ravel()])
    x, y, z = np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)
    ahead, left, up = (z, x, y) if boresight == "z" else (x, y, z)
    gain = antenna.gain(np.column_stack([ahead, left, up]))
    return theta.ravel(), phi.ravel(), 10 * np.log10(np.maximum(gain, 1e-8))


def csv_grid(antenna: Antenna, path: Path, boresight: str = "z") -> Path:
    rows = np.column_stack(sphere(antenna, boresight))
    np.savetxt(path, rows, "%.5f", ",", header="theta_deg,phi_deg,gain_db", comments="")
    return path


def cut_db(antenna: Antenna, angle_deg: np.ndarray, axis: int) -> np.ndarray:
    direction = np.zeros((len(angle_deg), 3))
    direction[:, 0], direction[:, axis] = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    return 10 * np.log10(np.maximum(antenna.gain(direction), 1e-8))


def csv_cuts(antenna: Antenna, path: Path) -> Path:
    angle = np.arange(-180.0, 180.1, 1.0)
    rows = np.column_stack([angle, cut_db(antenna, angle, 1), cut_db(antenna, angle, 2)])
    np.savetxt(path, rows, "%.5f", ",", header="angle_deg,azimuth_db,elevation_db", comments="")
    return path


def planet(antenna: Antenna, path: Path) -> Path:
    angle = np.arange(360.0)
    # Clockwise and downward: the other way around than left and up.
    right, down = cut_db(antenna, -angle, 1), cut_db(antenna, -angle, 2)
    peak = max(right.max(), down.max())
    lines = ["NAME made for a test", "FREQUENCY 77000", f"GAIN {peak:.2f} dBi", "TILT MECHANICAL"]
    for title, power in (("HORIZONTAL", right), ("VERTICAL", down)):
        lines += [f"{title} 360", *(f"{a:.1f} {peak - p:.3f}" for a, p in zip(angle, power, strict=True))]
    path.write_text("\n".join(lines), encoding="latin-1")
    return path


def hfss_report(antenna: Antenna, path: Path) -> Path:
    theta, phi, gain = sphere(antenna)
    lines = ['"Phi [deg]","Theta [deg]","dB(GainTotal) [] - Freq=\'77GHz\'"']
    lines += [f"{p},{t},{g:.5f}" for t, p, g in zip(theta, phi, gain, strict=True)]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def hfss_by_phi(antenna: Antenna, path: Path) -> Path:
    """Thetas from -180 to 180 and phis below 180, a column each, as HFSS reports cuts."""
    theta, phi, gain = sphere(antenna)
    at = {(round(t), round(p)): g for t, p, g in zip(theta, phi, gain, strict=True)}
    phis = np.arange(0, 180, int(STEP_DEG))
    lines = ['"Theta [deg]",' + ",".join(f"\"dB(GainTotal) [] - Freq='77GHz' Phi='{p}deg'\"" for p in phis)]
    for t in np.arange(-180, 181, int(STEP_DEG)):
        values = [at[abs(int(t)), int(p if t >= 0 else p + 180)] for p in phis]
        lines.append(f"{t}," + ",".join(f"{v:.5f}" for v in values))
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def hfss_field(antenna: Antenna, path: Path) -> Path:
    _, _, gain = sphere(antenna)
    count = round(180 / STEP_DEG) + 1
    lines = [f"0 180 {count}", f"0 360 {2 * count - 1}", "Frequencies 1", "Frequency 77000000000"]
    lines += [f"{a:.8e} 0 {a:.8e} 0" for a in np.sqrt(10 ** (gain / 10) / 2)]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def cst_table(antenna: Antenna, path: Path) -> Path:
    head = "Theta [deg.]  Phi   [deg.]  Abs(Dir.)[dBi   ]   Abs(Theta)[dBi   ]  Phase(Theta)[deg.]  Ax.Ratio[dB    ]"
    rows = (f"{t:8.3f} {p:8.3f} {g:14.3e} {g:14.3e} 0.0 40.0" for t, p, g in zip(*sphere(antenna), strict=True))
    path.write_text("\n".join([head, "-" * 90, *rows]), encoding="utf-8")
    return path


def cst_source(antenna: Antenna, path: Path) -> Path:
    theta, phi, gain = sphere(antenna)
    count = round(180 / STEP_DEG) + 1
    lines = [
        "// CST Farfield Source File",
        "// #Frequencies",
        "1",
        "// >> Total #phi samples, total #theta samples",
        f"{2 * count - 1} {count}",
        "// >> Phi, Theta, Re(E_Theta), Im(E_Theta), Re(E_Phi), Im(E_Phi):",
    ]
    order = np.lexsort((theta, phi))
    lines += [f"{phi[i]} {theta[i]} 0 {np.sqrt(10 ** (gain[i] / 10)):.8e} 0 0" for i in order]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


WRITERS: dict[str, tuple[str, Callable[[Antenna, Path], Path]]] = {
    "CSV of a grid": ("grid.csv", csv_grid),
    "CSV of cuts": ("cuts.csv", csv_cuts),
    "MSI Planet": ("panel.msi", planet),
    "report of HFSS": ("report.csv", hfss_report),
    "report of HFSS by phi": ("by_phi.csv", hfss_by_phi),
    "field of HFSS": ("exported.ffd", hfss_field),
    "table of CST": ("farfield.txt", cst_table),
    "source of CST": ("farfield.ffs", cst_source),
}
