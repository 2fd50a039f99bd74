"""Run one folder of tests in the Python environment of its host, and keep a report.

Exit code 77 stands for skipped: the host is missing, or every test of the folder was skipped. With
ELASTOIDENTIFY_REQUIRE_HOSTS=1 in the environment a missing host is a failure.
"""

import argparse
import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

SKIPPED = 77
NO_TESTS_COLLECTED = 5


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name")
    parser.add_argument("--environment", type=Path, required=True)
    parser.add_argument("--reports", type=Path, required=True)
    parser.add_argument("pytest", nargs="+")
    options = parser.parse_args()

    options.reports.mkdir(parents=True, exist_ok=True)
    report = options.reports / f"{options.name}.xml"
    report.unlink(missing_ok=True)
    missing = options.environment / "missing.txt"
    if missing.exists():
        return host_missing(options.name, report, *missing.read_text().splitlines()[:2])

    folder = "Scripts" if os.name == "nt" else "bin"
    python = options.environment / folder / "python"
    command = [str(python), "-m", "pytest", "-q", "-ra", "--color=no", f"--junitxml={report}"]
    code = subprocess.run([*command, *options.pytest], check=False).returncode
    if code == NO_TESTS_COLLECTED or (code == 0 and all_skipped(report)):
        return SKIPPED
    return code


def host_missing(name: str, report: Path, reason: str, command: str) -> int:
    """Say what is missing and how to get it; skipped, or failed where hosts are required."""
    required = os.environ.get("ELASTOIDENTIFY_REQUIRE_HOSTS") == "1"
    outcome = "failure" if required else "skipped"
    message = f"{reason}. To enable: {command}"
    print(f"{outcome.upper()}: {message}")
    suite = ET.Element("testsuite", name=name)
    case = ET.SubElement(suite, "testcase", classname=name, name="host")
    ET.SubElement(case, outcome, message=message)
    ET.ElementTree(suite).write(report, encoding="utf-8")
    return 1 if required else SKIPPED


def all_skipped(report: Path) -> bool:
    """Whether no test of the report ran."""
    cases = list(ET.parse(report).iter("testcase"))
    return all(case.find("skipped") is not None for case in cases)


if __name__ == "__main__":
    sys.exit(main())
