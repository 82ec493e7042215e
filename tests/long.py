"""Tests that took long when all were measured: the quick part leaves them out, and the longest wait for `--exhaustive`.

`python -m pytest -n auto --exhaustive --junitxml=times.xml`, with nothing kept, then `python tests/long.py times.xml`
writes long.txt anew: seconds and node id a line; tests that were not run keep theirs. Who compiles what several tests
share depends on the order: one may be long that is short alone.
"""

import pathlib
import sys
import xml.etree.ElementTree
from collections import defaultdict
from collections.abc import Iterable

FILE = pathlib.Path(__file__).with_name("long.txt")
LONG, LONGEST = 2.5, 20.0  # s


def listed() -> dict[str, float]:
    """Seconds by node id, of the tests in the file."""
    pairs = (line.split(" ", 1) for line in FILE.read_text().splitlines())
    return {name: float(seconds) for seconds, name in pairs}


def longest(names: Iterable[str]) -> set[str]:
    """Those of `names` that wait to be asked for; of a file of which all would, the shortest does not."""
    seconds, files = listed(), defaultdict(list)
    for name in names:
        files[name.split("::")[0]].append(name)
    found: set[str] = set()
    for own in files.values():
        out = [name for name in own if seconds.get(name, 0) > LONGEST]
        kept = [min(own, key=lambda name: seconds[name])] if len(out) == len(own) else []
        found.update(name for name in out if name not in kept)
    return found


def read(path: str) -> dict[str, float]:
    """Seconds by node id, from what pytest wrote with --junitxml."""
    times = {}
    for case in xml.etree.ElementTree.parse(path).getroot().iter("testcase"):
        place = case.attrib["classname"].replace(".", "/")
        times[f"{place}.py::{case.attrib['name']}"] = float(case.attrib["time"])
    return times


def stands(name: str) -> bool:
    """Whether there still is a test function of that name in its file."""
    file, *_, function = name.split("[")[0].split("::")
    path = FILE.parents[1] / file
    return path.exists() and f"def {function}(" in path.read_text()


if __name__ == "__main__":
    measured = {name: seconds for name, seconds in listed().items() if stands(name)} | read(sys.argv[1])
    FILE.write_text("".join(f"{seconds:.1f} {name}\n" for name, seconds in sorted(measured.items()) if seconds > LONG))
