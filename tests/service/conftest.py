"""Fixtures of the service tests."""

from tests.fixtures.serving import api, live, live_settings, make_settings, settings, tiny_folder

__all__ = ["api", "live", "live_settings", "make_settings", "settings", "tiny_folder"]
