"""What a sensor observed over a stretch of the flight, and its bytes, by which an interrupted survey goes on."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sionna_radar.accuracy.truth import Counted
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.profiles import Profiles, VolumeInFront
from sionna_radar.foundation.packing import OF, columns_of, packed, table_of


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
