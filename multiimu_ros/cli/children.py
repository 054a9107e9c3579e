"""Child processes of a verb: started together, watched, and ended on every path."""

from collections.abc import Mapping, Sequence
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from types import TracebackType
from typing import Self

from multiimu_ros.errors import MultiImuError

PATIENCE = 5.0  # [s] from SIGINT to SIGKILL; the nodes need 0.3 s
TAIL = 8  # lines of a dead child's output that are shown
CALL = 'import sys; from {0} import main; sys.exit(main())'


class Children:
    """Processes that run the `main` of our modules, each with a log file of its own.

    A context manager: leaving it ends those that still run, the last one started first.  They are
    in sessions of their own, so that Ctrl-C reaches the verb alone, which ends them in order.

    Parameters
    ----------
    logs : Path
        Folder for `<name>.log`.
    environment : mapping
        Added to this process's own.
    """

    def __init__(self, logs: Path, environment: Mapping[str, str]) -> None:
        self._logs = logs
        self._environment = {**os.environ, 'PYTHONUNBUFFERED': '1', **environment}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, module: str, arguments: Sequence[str]) -> None:
        """Run `main` of a module with these arguments."""
        with self.log(name).open('wb') as log:
            self._processes[name] = subprocess.Popen(
                [sys.executable, '-c', CALL.format(module), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
                start_new_session=True,
            )

    def log(self, name: str) -> Path:
        """Return the file that holds what a child has said."""
        return self._logs / f'{name}.log'

    def pid(self, name: str) -> int:
        """Return the process id of a child."""
        return self._processes[name].pid

    def running(self, name: str) -> bool:
        """Say whether a child still runs.

        Raises
        ------
        MultiImuError
            If any child has failed; shows the end of what it said.
        """
        for each, process in self._processes.items():
            code = process.poll()
            if code:
                raise MultiImuError(self._obituary(each, code))
        return self._processes[name].poll() is None

    def _obituary(self, name: str, code: int) -> str:
        lines = self.log(name).read_text(encoding='utf-8', errors='replace').splitlines()
        tail = '\n'.join(f'    {line}' for line in lines[-TAIL:]) or '    (it said nothing)'
        how = f'signal {signal.Signals(-code).name}' if code < 0 else f'exit code {code}'
        return f'`{name}` ended early with {how}; its last words:\n{tail}'

    def end(self, name: str) -> None:
        """Ask a child to end, and wait until it has."""
        process = self._processes[name]
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        self._wait(process, PATIENCE)

    @staticmethod
    def _wait(process: 'subprocess.Popen[bytes]', patience: float) -> None:
        try:
            process.wait(patience)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        processes = list(reversed(self._processes.values()))
        for process in processes:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + PATIENCE
        for process in processes:
            self._wait(process, max(deadline - time.monotonic(), 0.1))
