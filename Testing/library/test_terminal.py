"""Figures and progress for people."""

import io

import pytest
from elastoidentify.report import terminal


class Screen(io.StringIO):
    """A terminal that remembers what it was sent."""

    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0"), (3.14159, "3.14"), (1234.5, "1234"), (0.0123456, "0.0123"), (float("nan"), "-"),
     (1e9, "1.00e+09"), (-2.5e-6, "-2.50e-06")],
)  # fmt: skip
def test_figures_have_three_significant_digits(value, text):
    assert terminal.figure(value) == text


def test_durations_are_for_people():
    assert terminal.seconds(4.21) == "4.2 s"
    assert terminal.seconds(190) == "3 min 10 s"


def test_progress_rewrites_one_line_on_a_terminal_and_clears_it(monkeypatch):
    clock = iter(range(100))
    monkeypatch.setattr(terminal.time, "monotonic", lambda: 0.5 * next(clock))
    screen = Screen()
    with terminal.TerminalProgress("work", screen) as progress:
        progress(0.1, "a long first step")
        progress(0.5, "second")
    assert "\n" not in screen.getvalue()
    last = screen.getvalue().split("\r")[-1]
    assert last == ""
    assert screen.getvalue().split("\r")[-2].strip() == ""
    assert " 50 % second" in screen.getvalue()


def test_progress_in_a_log_is_sparse(monkeypatch):
    clock = iter(range(1000))
    monkeypatch.setattr(terminal.time, "monotonic", lambda: next(clock))
    log = io.StringIO()
    with terminal.TerminalProgress("work", log) as progress:
        for step in range(100):
            progress(step / 100, "step")
    lines = log.getvalue().splitlines()
    assert 8 <= len(lines) <= 12
    assert lines[-1].startswith("work: 1 min")
    assert len(set(lines)) == len(lines)


def test_a_table_has_flush_columns():
    text = terminal.table(["a", "b"], [["long name", "1"], ["x", "22"]])
    assert text.splitlines() == ["a           b", "long name   1", "x          22"]
