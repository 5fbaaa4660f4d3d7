"""`python -m sionna_radar` is `sionna-radar`; interrupts are handled from before the first heavy import."""

from sionna_radar.foundation.interrupts import interrupts_reported
from sionna_radar.foundation.supervisor import supervised


def main() -> None:
    """Run the command line."""
    supervised(_command_line)


def _command_line() -> None:
    with interrupts_reported():
        from sionna_radar.cli.app import main as command_line

        command_line()


if __name__ == "__main__":
    main()
