"""Scenarios: what is flown, over what, with which radar."""

from sionna_radar.scenario.loading import load_scenario, parse_scenario, shipped_scenarios, to_toml
from sionna_radar.scenario.scenario import Scenario

__all__ = ["Scenario", "load_scenario", "parse_scenario", "shipped_scenarios", "to_toml"]
