"""What tests of characters share."""

from __future__ import annotations

from tests.fixtures.laid_bodies import lay_bodies_once

lay_bodies_once()
