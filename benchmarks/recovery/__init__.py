"""How near a recovered pattern is to the one that was draped."""
