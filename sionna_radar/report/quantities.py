"""Scenario keys as labels of figures: words, with the unit in brackets."""

UNITS = {
    "mm_per_h": "mm/h",
    "g_per_m3": "g/m³",
    "per_m2": "1/m²",
    "mps": "m/s",
    "mps2": "m/s²",
    "hz": "Hz",
    "dbsm": "dBsm",
    "dbm": "dBm",
    "db": "dB",
    "deg": "deg",
    "rpm": "rpm",
    "hpa": "hPa",
    "celsius": "°C",
    "m": "m",
    "s": "s",
}
# Last parts of keys that need the name of their table.
VAGUE = ("guard", "height", "kind", "material", "method", "mode", "model", "path", "rank", "seed", "training", "window")


def readable(key: str) -> str:
    """Return a dotted key as words with its unit, such as `Beamwidth (deg)`."""
    *tables, name = key.split(".")
    unit = next((unit for unit in UNITS if name.endswith(f"_{unit}")), None)
    words = name.removesuffix(f"_{unit}") if unit else name
    if words in VAGUE and tables:
        words = f"{tables[-1]} {words}"
    words = words.replace("_", " ").replace("dem ", "DEM ").replace("cfar", "CFAR").replace("snr", "SNR")
    return words[:1].upper() + words[1:] + (f" ({UNITS[unit]})" if unit else "")
