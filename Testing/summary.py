"""Add up the reports of all suites: what failed, what was skipped and why, and one closing line.

    python summary.py REPORTS [SUITE ...]

A suite that is named and left no report counts as one failure: it did not get to its end.
"""

import sys
import xml.etree.ElementTree as ET
from collections import Counter, defaultdict
from pathlib import Path


def outcome(case: ET.Element) -> tuple[str, str]:
    """Return passed, failed or skipped, and the reason for the last two."""
    for tag, word in (("failure", "failed"), ("error", "failed"), ("skipped", "skipped")):
        child = case.find(tag)
        if child is not None:
            lines = (child.get("message") or child.text or "").strip().splitlines()
            return word, lines[0] if lines else "no reason given"
    return "passed", ""


def main(reports: Path, suites: list[str]) -> int:
    counts, skipped, failed = Counter(), defaultdict(int), []
    for name in suites or sorted(path.stem for path in reports.glob("*.xml")):
        report = reports / f"{name}.xml"
        if not report.exists():
            counts["failed"] += 1
            failed.append(f"{name}: did not get to its end")
            continue
        for case in ET.parse(report).iter("testcase"):
            word, reason = outcome(case)
            counts[word] += 1
            if word == "failed":
                failed.append(f"{name}: {case.get('name')}: {reason}")
            elif word == "skipped":
                skipped[f"{name}: {reason}"] += 1

    if skipped:
        print("Skipped:")
        print(*(f"  {number:3d} × {reason}" for reason, number in skipped.items()), sep="\n")
    if failed:
        print("Failed:")
        print(*(f"  {line}" for line in failed), sep="\n")
    print(f"{counts['passed']} passed, {counts['failed']} failed, {counts['skipped']} skipped")
    return 1 if counts["failed"] or not counts["passed"] else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
