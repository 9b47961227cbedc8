"""Exit statuses of commands."""

import subprocess
import sys

import pytest

from drape.errors import REFUSED_EXIT_CODE, UNREAD_EXIT_CODE, InputError, exit_status, refusing


def test_a_refusal_becomes_its_sentence_and_a_status(capsys: pytest.CaptureFixture[str]) -> None:
    @refusing
    def main(count: int) -> int:
        if count < 0:
            raise InputError("count", expected="at least 0", got=str(count), cure="Count again.")
        return count

    assert main(0) == 0 and main(3) == 3
    assert capsys.readouterr().err == ""
    assert main(-1) == REFUSED_EXIT_CODE
    shown = capsys.readouterr()
    assert "count" in shown.err and "Count again." in shown.err and len(shown.err.splitlines()) == 1
    assert shown.out == ""


def test_other_errors_pass() -> None:
    @refusing
    def main() -> int:
        raise ValueError("a bug")

    with pytest.raises(ValueError, match="a bug"):
        main()


def test_a_record_is_no_status(capsys: pytest.CaptureFixture[str]) -> None:
    def refused() -> dict[str, int]:
        raise InputError("count", expected="at least 0", got="-1", cure="Count again.")

    assert exit_status(lambda: {"rows": 3}) == 0
    assert exit_status(refused) == REFUSED_EXIT_CODE
    assert "Count again." in capsys.readouterr().err


@pytest.mark.parametrize("words", [["drape", "garments"], ["drape", "tiers", "--json"]])
def test_a_reader_that_has_gone_ends_a_command_without_a_word(words: list[str]) -> None:
    command = [sys.executable, "-m", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == UNREAD_EXIT_CODE == 141


def test_a_pipe_that_is_not_the_output_is_an_error() -> None:
    @refusing
    def main() -> int:
        raise BrokenPipeError("a child's input")

    with pytest.raises(BrokenPipeError, match="a child's input"):
        main()
