# SPDX-License-Identifier: Apache-2.0
"""The entry script `pam-orthosis VERB`: one module a verb, loaded when it is called.

Exit status: 0 good, 1 the answer is no, 2 unusable input or usage, 3 a node or the run failed.
"""

import argparse
import os
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from importlib import import_module
from io import TextIOWrapper
from threading import current_thread, main_thread
from types import FrameType, ModuleType
from typing import Any, NoReturn

from pam_orthosis import __version__
from pam_orthosis.cli.help_texts import STATUSES, epilog
from pam_orthosis.errors import OrthosisError, RunFailed
from pam_orthosis.processes import ENDING

VERBS = {
    "run": "start the node graph, record a bag, judge it",
    "session": "train an emulated person on both legs by a programme, record a bag",
    "replay": "feed the samples of a bag to the nodes again, compare their answers",
    "check": "judge the tracking of a recorded bag",
    "rig": "record the identification procedure on the emulated test rig",
    "identify": "muscle parameters from rig bags or measured tables",
    "gap": "find where model and recordings disagree, name the missing effect, show how much it explains",
    "report": "draw a recorded run",
    "paper": "compute the paper's figures and results again, side by side",
    "improve": "learn missing effects, let the controllers use them, show tracking before and after",
    "margin": "how far the hardware may change before the machine follows badly or is lost",
    "plan": "plan a gait within the reach of muscles and supply, by the nominal model",
    "batch": "do the same to many bags or parameter sets, on all cores or a cluster",
    "gap-hide": "record a blind test case of the gap workflow",
    "recover": "make a readable bag of one whose recorder was killed",
    "example": "write recordings that come with the package: bags to look at, a case for gap",
}
TRACEBACK = "PAM_ORTHOSIS_TRACEBACK"
_interrupted: list[int] = []
_over: list[bool] = []  # holds something as soon as the work of a verb is over
Handler = Callable[[int, FrameType | None], Any] | int | None


class Parser(argparse.ArgumentParser):
    """A parser that reports a wrong usage as the one-line error of this program."""

    def error(self, message: str) -> NoReturn:
        """Raise OrthosisError."""
        raise OrthosisError(f"{message}; see `{self.prog} --help`")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a verb; return the exit status."""
    before: dict[int, Handler] = {}
    try:
        _interrupted.clear()
        _over.clear()
        if current_thread() is main_thread():
            _catch_signals(before)
        status = _worked(sys.argv[1:] if arguments is None else list(arguments))
        _over.append(True)
    except KeyboardInterrupt as error:  # on the way to the work, or from it
        _over.append(True)
        status = _failed(*_failure(error))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():  # a process that ends does so undisturbed
            signal.signal(number, signal.SIG_IGN if arguments is None else handler)
    return status


def _worked(arguments: Sequence[str]) -> int:
    """Do what is asked for; return the exit status. No signal is heard any more when its end is told."""
    try:
        for stream in (sys.stdout, sys.stderr):  # names of files need not be text
            if isinstance(stream, TextIOWrapper) and stream.errors == "strict":
                stream.reconfigure(errors="backslashreplace")
        return _dispatch(arguments)
    except BrokenPipeError:  # nobody reads the rest
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except SystemExit:  # of --help
        raise
    except BaseException as error:
        _over.append(True)
        return _failed(*_failure(error))


def _failure(error: BaseException) -> tuple[str, int]:
    """Return what went wrong, and the exit status; raise what nobody foresaw if that is asked for."""
    if isinstance(error, OrthosisError):
        return str(error), error.exit_status
    if isinstance(error, KeyboardInterrupt) or _interrupted:  # modules in C make something else of it
        return "interrupted", 3
    if isinstance(error, OSError):
        about = f"{error.filename!r}: " if error.filename else ""
        return about + (error.strerror or str(error) or type(error).__name__), 2
    if isinstance(error, RuntimeError) and str(error).startswith("Symlink loop"):  # of Path.resolve
        return f"{error}: give a path without it", 2
    if isinstance(error, MemoryError):
        return "not enough memory for this input", 2
    if os.environ.get(TRACEBACK):
        raise error
    return f"unforeseen {_told(error)}; {TRACEBACK}=1 shows where it came from", 3  # 1 would be an answer


def _told(error: BaseException) -> str:
    """Return an error and the line of this package in which it was raised, or from which."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "pam_orthosis" in frame.filename] or frames
    return f"{type(error).__name__} in {os.path.basename(own[-1].filename)}:{own[-1].lineno}: {error}"


def _catch_signals(before: dict[int, Handler]) -> None:
    """Let all signals that ask for an end do what SIGINT does; what is ignored, as by `nohup`, stays so.

    `before` gets what was done about them.
    """
    before[signal.SIGALRM] = signal.signal(signal.SIGALRM, _interrupt_again)
    for number in ENDING:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            before[number] = signal.signal(number, _interrupt)


def _interrupt(number: int, _frame: FrameType | None) -> None:
    """End a verb: what was begun is tidied up, once, whatever comes meanwhile."""
    error = sys.exc_info()[1]
    while error:
        if isinstance(error, (KeyboardInterrupt, RunFailed)):
            return
        error = error.__context__
    if _interrupted or _over:
        return
    _interrupted.append(number)
    signal.setitimer(signal.ITIMER_REAL, 0.5, 0.5)  # C code may swallow what is raised here
    raise KeyboardInterrupt


def _interrupt_again(_number: int, _frame: FrameType | None) -> None:
    """Interrupt a verb that goes on as if it had not been asked to end, unless it deals with an error."""
    if not _over and sys.exc_info()[1] is None:
        raise KeyboardInterrupt


def _failed(message: str, status: int) -> int:
    """Print an error as one readable line, whatever the input smuggled into it; return the exit status."""
    line = "".join(c if c.isprintable() else " " for c in message)
    most = 900
    kind = "" if line.startswith("interrupted") else "error: "  # who asks for an end gets what they ask for
    print(f"pam-orthosis: {kind}{line[:most]}{' ...' * (len(line) > most)}", file=sys.stderr)
    return status


def _dispatch(arguments: Sequence[str]) -> int:
    verb = arguments[0] if arguments else "--help"
    if verb not in VERBS:
        _top_parser().parse_args(arguments[:2] or [verb])
    return int(_module(verb).execute(verb_parser(verb).parse_args(arguments[1:])))


def verb_parser(verb: str) -> Parser:
    """Return the parser of a verb: its arguments, and help with examples and exit statuses."""
    module = _module(verb)
    parser = Parser(
        prog=f"pam-orthosis {verb}",
        description=(module.__doc__ or "").strip(),
        epilog=epilog(verb),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(parser)
    return parser


def _module(verb: str) -> ModuleType:
    return import_module(f"pam_orthosis.cli.{verb.replace('-', '_')}")


def _top_parser() -> Parser:
    from pam_orthosis.cli import completion  # verbs need none of it

    verbs = "\n".join(f"  {verb:10s} {meaning}" for verb, meaning in VERBS.items())
    parser = Parser(
        prog="pam-orthosis",
        description="Emulated knee orthosis with two antagonistic fluidic muscles.",
        epilog=f"verbs:\n{verbs}\n\n`pam-orthosis VERB --help` shows arguments and examples.\n{STATUSES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("verb", choices=VERBS, metavar="VERB", help="what to do")
    parser.add_argument("--version", action="version", version=f"pam-orthosis {__version__}")
    about = 'print a script that completes arguments; bash: eval "$(pam-orthosis --print-completion bash)"'
    parser.add_argument(
        "--print-completion",
        action=completion.Print,
        choices=completion.SHELLS,
        parsers=lambda: {name: verb_parser(name) for name in VERBS},
        help=about,
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
