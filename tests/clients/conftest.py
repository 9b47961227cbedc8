"""Fixtures of the client tests."""

from tests.fixtures.serving import api, body, live, live_settings, make_settings, settings, tiny_folder, tube

__all__ = ["api", "body", "live", "live_settings", "make_settings", "settings", "tiny_folder", "tube"]
