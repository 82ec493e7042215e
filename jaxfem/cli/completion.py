"""`jaxfem completion SHELL`: what makes a shell complete commands, options and files; made from the parser."""

import argparse
from collections.abc import Iterator
from typing import Any

SHELLS = ("bash", "zsh", "fish")
_BASH = """\
_jaxfem() {{
  local line="${{COMP_WORDS[*]:1:COMP_CWORD-1}}" word="${{COMP_WORDS[COMP_CWORD]}}" known=""
  case "$line" in
{cases}
  esac
  COMPREPLY=($(compgen -W "$known" -- "$word"))
  case "$word" in -*) ;; *) COMPREPLY+=($(compgen -f -- "$word")) ;; esac
}}
complete -o filenames -F _jaxfem jaxfem
"""


def add(subparsers: Any) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "completion",
        help="complete commands in a shell",
        description='Print what makes a shell complete commands and options: put eval "$(jaxfem completion bash)" '
        "into ~/.bashrc (zsh: ~/.zshrc), or jaxfem completion fish into ~/.config/fish/completions/jaxfem.fish.",
    )
    parser.add_argument("shell", choices=SHELLS, help="the shell")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the script; 0."""
    from jaxfem.cli.main import parser  # it holds this command too

    print(script(args.shell, parser()), end="")
    return 0


def script(shell: str, parser: argparse.ArgumentParser) -> str:
    """The script for a shell."""
    known = dict(commands(parser))
    if shell == "fish":
        return "".join(_fish(known))
    longest = sorted(known, key=len, reverse=True)  # the first case that fits is taken
    cases = "\n".join(f'    "{each}"*) known="{" ".join(known[each])}" ;;' for each in longest)
    head = "autoload -Uz bashcompinit && bashcompinit\n" if shell == "zsh" else ""
    return head + _BASH.format(cases=cases)


def commands(parser: argparse.ArgumentParser, before: str = "") -> Iterator[tuple[str, list[str]]]:
    """(words that stand before, what may follow them) of the parser and of all its commands."""
    words: list[str] = []
    for action in parser._actions:
        words += action.option_strings
        if isinstance(action, argparse._SubParsersAction):
            words += action.choices
            for name, inner in action.choices.items():
                yield from commands(inner, f"{before} {name}".strip())
        elif not action.option_strings and action.choices:
            words += action.choices
    yield before, words


def _fish(known: dict[str, list[str]]) -> Iterator[str]:
    for before, words in sorted(known.items()):
        inner = f"__fish_seen_subcommand_from {before.split()[-1]}" if before else "__fish_use_subcommand"
        for word in words:
            kind = (
                f"-l {word[2:]}"
                if word.startswith("--")
                else f"-s {word[1:]}"
                if word.startswith("-")
                else f"-a {word}"
            )
            yield f"complete -c jaxfem -n '{inner}' {kind}\n"
