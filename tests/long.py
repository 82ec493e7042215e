"""Tests that the quick part leaves out beside those marked in their files: what took long when all were measured.

`python -m pytest -n auto --junitxml=times.xml`, with nothing kept, then `python tests/long.py times.xml` writes
long.txt anew. Who compiles what several tests share depends on the order: one may be long that is short alone.
"""

import pathlib
import sys
import xml.etree.ElementTree

FILE = pathlib.Path(__file__).with_name("long.txt")
LONG = 3.0  # s


def listed() -> set[str]:
    """Node ids of the tests in the file."""
    return set(FILE.read_text().splitlines())


def measured(times: dict[str, float]) -> list[str]:
    """Node ids of those that took long, of seconds by node id."""
    return sorted(name for name, seconds in times.items() if seconds > LONG)


def read(path: str) -> dict[str, float]:
    """Seconds by node id, from what pytest wrote with --junitxml."""
    times = {}
    for case in xml.etree.ElementTree.parse(path).getroot().iter("testcase"):
        place = case.attrib["classname"].replace(".", "/")
        times[f"{place}.py::{case.attrib['name']}"] = float(case.attrib["time"])
    return times


if __name__ == "__main__":
    FILE.write_text("".join(f"{name}\n" for name in measured(read(sys.argv[1]))))
