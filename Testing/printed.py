"""Compare printed lines with those of a page: words must be equal, numbers nearly so."""

import re

NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")


def check(printed: str, shown: str, rtol: float = 0.1) -> None:
    """Fail where `printed` is not what is `shown`.

    Parameters
    ----------
    printed, shown : str
        A shown line that ends in … is the start of one; a line … alone stands for any lines.
    rtol : float
        How far numbers may differ: other processors and libraries register images a little
        otherwise. One unit of the last digit that is shown is always allowed.
    """
    rest = [line for line in printed.strip().splitlines() if line.strip()]
    skip = False
    for line in (line for line in shown.strip().splitlines() if line.strip()):
        if line.strip() == "…":
            skip = True
            continue
        while skip and rest and not is_same(rest[0], line, rtol):
            rest.pop(0)
        assert rest, f"this line was not printed: {line}"
        found, skip = rest.pop(0), False
        assert is_same(found, line, rtol), f"shown:   {line}\nprinted: {found}"
    assert skip or not rest, f"printed, and not shown: {rest}"


def is_same(found: str, shown: str, rtol: float) -> bool:
    """Tell whether a printed line is the one that is shown."""
    cut = shown.rstrip().endswith("…")
    shown = shown.rstrip().removesuffix("…").rstrip()
    words = [re.split(r"\s+", NUMBER.sub("#", text).strip()) for text in (found, shown)]
    numbers = [NUMBER.findall(text) for text in (found, shown)]
    if cut:
        words[0] = words[0][: len(words[1])]
        numbers[0] = numbers[0][: len(numbers[1])]
        words[0][-1] = words[0][-1][: len(words[1][-1])]
    if words[0] != words[1] or len(numbers[0]) != len(numbers[1]):
        return False
    return all(_near(a, b, rtol) for a, b in zip(*numbers, strict=True))


def _near(found: str, shown: str, rtol: float) -> bool:
    decimals = len(shown.partition("e")[0].partition(".")[2])
    unit = 10.0**-decimals * 10.0 ** float(shown.partition("e")[2] or 0)
    return abs(float(found) - float(shown)) <= rtol * abs(float(shown)) + 1.01 * unit
