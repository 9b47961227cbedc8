"""The version of the installed product."""

from __future__ import annotations

import importlib.metadata


def product_version() -> str:
    """The version in the package's metadata; "unknown" where the folder runs without being installed."""
    try:
        return importlib.metadata.version("drape")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"
