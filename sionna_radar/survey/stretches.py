"""What a sensor observed over a stretch of the flight, and its bytes, by which an interrupted survey goes on."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from sionna_radar.accuracy.truth import Counted
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.profiles import Profiles, VolumeInFront

# Between the name of a table and that of its column.
OF = "."


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """What a sensor observed over some consecutive blocks of pulses.

    echoes: sorted by pulse, not corrected for Doppler; profiles: around them, where the map wants them.
    lost: pulses without an echo because rain masks the ground.
    saturated_pulses, saturated_samples: those that the receiver's converter clipped.
    """

    echoes: Echoes
    profiles: Profiles | None
    lost: int
    saturated_pulses: int = 0
    saturated_samples: int = 0

    @staticmethod
    def joined(stretches: Sequence["Stretch"]) -> "Stretch":
        """Return what was observed over some stretches in order."""
        profiles = [one.profiles for one in stretches if one.profiles is not None]
        return Stretch(
            echoes=Echoes.concatenate([one.echoes for one in stretches]),
            profiles=Profiles.concatenate(profiles) if profiles else None,
            lost=sum(one.lost for one in stretches),
            saturated_pulses=sum(one.saturated_pulses for one in stretches),
            saturated_samples=sum(one.saturated_samples for one in stretches),
        )


@dataclass(frozen=True, kw_only=True)
class FinishedStretch:
    """A stretch, and the true hits that were counted over it."""

    seen: Stretch
    counted: Counted

    def packed(self) -> bytes:
        """Return its bytes, from which `unpacked` makes it again, bit for bit."""
        return packed(seen=self.seen, counted=self.counted)

    @staticmethod
    def unpacked(content: bytes) -> "FinishedStretch":
        """Return the stretch of some bytes."""
        columns = columns_of(content)
        return FinishedStretch(seen=stretch_of(columns), counted=table_of(Counted, "counted", columns))


def packed(**values: Any) -> bytes:
    """Return the bytes of some tables, which may be nested, arrays and numbers by their names."""
    content = io.BytesIO()
    np.savez(
        content, **{key: column for name, value in values.items() for key, column in _columns(name, value).items()}
    )
    return content.getvalue()


def columns_of(content: bytes) -> dict[str, Any]:
    """Return the arrays of some bytes, those of a table by its name, a dot and theirs."""
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def stretch_of(columns: dict[str, Any]) -> Stretch:
    """Return what was packed as `seen`."""
    profiles, of_profiles = None, f"seen{OF}profiles"
    if f"{of_profiles}{OF}pulse" in columns:
        inner = f"{of_profiles}{OF}volume"
        volume = table_of(VolumeInFront, inner, columns) if f"{inner}{OF}power" in columns else None
        profiles = table_of(Profiles, of_profiles, columns, volume=volume)
    return Stretch(
        echoes=table_of(Echoes, f"seen{OF}echoes", columns),
        profiles=profiles,
        **{name: int(columns[f"seen{OF}{name}"]) for name in ("lost", "saturated_pulses", "saturated_samples")},
    )


def _columns(name: str, value: Any) -> dict[str, Any]:
    """Return the arrays and numbers of nested tables by their names; None has none."""
    if value is None:
        return {}
    if not is_dataclass(value):
        return {name: value}
    found: dict[str, Any] = {}
    for field in fields(value):
        found |= _columns(f"{name}{OF}{field.name}" if name else field.name, getattr(value, field.name))
    return found


def table_of(kind: type, name: str, columns: dict[str, Any], **others: Any) -> Any:
    """Return a table from its columns; a column without axes is a number, and one that may be left out None."""
    kept = {f.name: f"{name}{OF}{f.name}" for f in fields(kind) if f.name not in others}
    own = {key: columns[column] for key, column in kept.items() if column in columns}
    return kind(**{key: value.item() if value.ndim == 0 else value for key, value in own.items()}, **others)
