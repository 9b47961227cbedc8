"""Notes of intake: sentences that tell what was done to a file. A warning is a note for whoever sent the file."""

from __future__ import annotations

from collections.abc import Iterable

from pydantic import ValidationError

WARNING = "warning: "


def warning(words: str) -> str:
    """Returns the note that warns with ``words``."""
    return WARNING + words


def warnings_of(notes: Iterable[str]) -> tuple[str, ...]:
    """Returns the words of those ``notes`` that are warnings."""
    return tuple(note.removeprefix(WARNING) for note in notes if note.startswith(WARNING))


def absent_file(name: str) -> str:
    """Returns the warning that the file ``name``, which a mesh file names, was not sent with it."""
    return warning(f"{name!a:.80} is not beside the mesh: send it in the same zip")


def absent_picture(error: Exception) -> str:
    """Returns the warning that a picture is left out because of ``error``."""
    return warning(f"a picture is left out: {error}")


def absent_look(material: str, error: ValidationError) -> str:
    """Returns the warning that the look of ``material`` is left out because of ``error``, in 200 characters."""
    where = error.errors(include_url=False)[0]
    return warning(f"the look of {material} is left out: {where['loc'][0]}: {where['msg']}")[:200]
