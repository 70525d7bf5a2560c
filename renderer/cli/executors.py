"""Executors by the texts of `--executor`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import get_context
from typing import Any, Final, ParamSpec, TypeVar

from renderer.cli.output import OutputError
from renderer.cli.subcommand import Parser

P = ParamSpec("P")
R = TypeVar("R")

_KINDS: Final = "serial, processes, processes:N, threads:N, dask:ADDRESS"


class SerialExecutor(Executor):
    """An executor that runs each call in this process, when it is submitted."""

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """Run the call and return a finished future."""
        future: Future[R] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def add_executor(parser: Parser, what: str) -> None:
    """Add `--executor E`; `what` says what runs there."""
    parser.add_argument(
        "--executor",
        default="serial",
        metavar="E",
        help=f"where {what} run: {_KINDS} of a scheduler (default: %(default)s)",
    )


@contextmanager
def make_executor(text: str) -> Iterator[Executor]:
    """Yield the executor that `--executor` names."""
    kind, _, rest = text.partition(":")
    is_count = not rest or (rest.isascii() and rest.isdigit() and int(rest) > 0)
    if kind == "serial" and not rest:
        yield SerialExecutor()
    elif kind == "processes" and is_count:
        # Fresh processes: a driver's state doesn't survive a fork.
        with ProcessPoolExecutor(int(rest) if rest else None, mp_context=get_context("spawn")) as pool:
            yield pool
    elif kind == "threads" and is_count:
        with ThreadPoolExecutor(int(rest) if rest else None) as threads:
            yield threads
    elif kind == "dask" and rest:
        try:
            distributed: Any = import_module("distributed")
        except ModuleNotFoundError:
            raise OutputError(
                "--executor: dask is missing; install it with: pip install 'rhi[dask]'"
            ) from None
        try:
            client = distributed.Client(rest, timeout=30)
        except (OSError, TimeoutError, ValueError) as error:
            raise OutputError(f"--executor: no scheduler at {rest}: {error}") from None
        with client:
            yield client.get_executor()
    else:
        raise OutputError(f"--executor: {text!r} is none of {_KINDS}")
