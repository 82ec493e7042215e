"""The tables of docs/hard_cases.md, from the results of hard_cases.py and hard_cases_others.py."""

import json
import pathlib
from collections import Counter
from typing import Any

ROOT = pathlib.Path(__file__).resolve().parents[2]
RESULTS, PAGE = ROOT / "benchmarks" / "results", ROOT / "docs" / "hard_cases.md"


def rewritten(text: str) -> str:
    """The page with what stands between its marks made anew."""
    ours = json.loads((RESULTS / "hard_cases.json").read_text())
    theirs = json.loads((RESULTS / "hard_cases_others.json").read_text())
    parts = {
        "summary": summary(ours["lines"]),
        "table": table(ours["lines"]),
        "words": words(ours["lines"]),
        "others": others(theirs, ours["lines"]),
    }
    for name, made in parts.items():
        begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
        text = text[: text.index(begin) + len(begin)] + made + text[text.index(end) :]
    return text


def kind(line: dict[str, Any]) -> str:
    """How a line ended, in a word or two."""
    return str(line["outcome"]).split(":")[0]


def summary(lines: list[dict[str, Any]]) -> str:
    """How many of which kind, for each precision."""
    found = ""
    for dtype in dict.fromkeys(line["dtype"] for line in lines):
        counts = Counter(kind(line) for line in lines if line["dtype"] == dtype)
        found += f"* {dtype}: " + ", ".join(f"{count} {word}" for word, count in counts.most_common()) + "\n"
    return found


def table(lines: list[dict[str, Any]]) -> str:
    """A row a case: how it ended in each precision, by which routes where they differ."""
    dtypes = list(dict.fromkeys(line["dtype"] for line in lines))
    rows = [f"| case | {' | '.join(dtypes)} | energy growth | iterations |", "| --- |" + " --- |" * (len(dtypes) + 2)]
    for case in dict.fromkeys(line["case"] for line in lines):
        own = [line for line in lines if line["case"] == case]
        cells = [cell([line for line in own if line["dtype"] == dtype]) for dtype in dtypes]
        growth = max((line["energy_growth"] for line in own if line.get("energy_growth") is not None), default=None)
        most = max((line["iterations"] for line in own if line.get("iterations") is not None), default="")
        rows.append(f"| {case} | {' | '.join(cells)} | {'' if growth is None else f'{growth:.1g}'} | {most} |")
    return "\n".join(rows) + "\n"


def cell(lines: list[dict[str, Any]]) -> str:
    """One word where all routes agree, else each with its routes."""
    by: dict[str, list[str]] = {}
    for line in lines:
        by.setdefault(kind(line), []).append(line["route"])
    if len(by) == 1:
        return next(iter(by))
    return ", ".join(f"{word} ({', '.join(routes)})" for word, routes in by.items())


def words(lines: list[dict[str, Any]]) -> str:
    """What was said, or should have been, in all cases that are not right; each once."""
    told: dict[tuple[str, str], list[str]] = {}
    for line in lines:
        if kind(line) not in ("right", "not served"):
            told.setdefault((line["case"], line["outcome"]), []).append(f"{line['route']}, {line['dtype']}")
    return "".join(f"* {case} ({'; '.join(ways)}): {outcome}\n" for (case, outcome), ways in told.items())


def others(theirs: dict[str, Any], ours: list[dict[str, Any]]) -> str:
    """A row a case that some other engine was asked; ours beside it where it is the same case."""
    engines = list(dict.fromkeys((line["engine"], line["step"]) for line in theirs["lines"]))
    head = [f"{engine}, {step}" for engine, step in engines]
    rows = [f"| case | jaxfem, 1/60 s | {' | '.join(head)} |", "| --- |" + " --- |" * (len(head) + 1)]
    for case in dict.fromkeys(line["case"] for line in theirs["lines"]):
        found = {(line["engine"], line["step"]): kind(line) for line in theirs["lines"] if line["case"] == case}
        mine = [line for line in ours if line["case"].startswith(case) and line["dtype"] == "float64"]
        own = kind(mine[0]) if mine else ""
        rows.append(f"| {case} | {own} | {' | '.join(found.get(each, '') for each in engines)} |")
    versions = dict.fromkeys(f"{line['engine']} {line['version']}" for line in theirs["lines"])
    left = "".join(f" Left out: {reason}." for reason in theirs["left_out"].values())
    return "\n".join(rows) + f"\n\n{', '.join(versions)}.{left}\n"


def main() -> None:
    """Write the page anew."""
    PAGE.write_text(rewritten(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
