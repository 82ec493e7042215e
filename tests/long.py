"""Tests that took long when all were measured: the quick part leaves them out, and the longest wait for `--exhaustive`.

`python -m pytest -n auto --exhaustive --junitxml=times.xml`, with nothing kept, then `python tests/long.py times.xml`
writes long.txt anew: seconds and node id a line. Who compiles what several tests share depends on the order: one may be
long that is short alone.
"""

import pathlib
import sys
import xml.etree.ElementTree

FILE = pathlib.Path(__file__).with_name("long.txt")
LONG, LONGEST = 3.0, 30.0  # s


def listed() -> dict[str, float]:
    """Seconds by node id, of the tests in the file."""
    pairs = (line.split(" ", 1) for line in FILE.read_text().splitlines())
    return {name: float(seconds) for seconds, name in pairs}


def read(path: str) -> dict[str, float]:
    """Seconds by node id, from what pytest wrote with --junitxml."""
    times = {}
    for case in xml.etree.ElementTree.parse(path).getroot().iter("testcase"):
        place = case.attrib["classname"].replace(".", "/")
        times[f"{place}.py::{case.attrib['name']}"] = float(case.attrib["time"])
    return times


if __name__ == "__main__":
    lines = [f"{seconds:.0f} {name}\n" for name, seconds in sorted(read(sys.argv[1]).items()) if seconds > LONG]
    FILE.write_text("".join(lines))
