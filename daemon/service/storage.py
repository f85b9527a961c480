"""Write the store and the state in a thread of their own, because fsync is slow.

Writes keep their order, so that the state never refers to a calibration that the store does not have. A
write that fails is tried again later and delays nothing else.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from stillcal.calib_core.engine.actions import Forget, Publish, Reject
from stillcal.daemon.service import saved_state
from stillcal.daemon.store.document import StoreDocument
from stillcal.daemon.store.files import StoreBusyError, StoreError, StoreLockedError, store_error
from stillcal.daemon.store.store import Outcome, Store, StoreSettings
from stillcal.daemon.system import memory
from stillcal.daemon.system.files import make_folder
from stillcal.daemon.system.worker import Worker

T = TypeVar("T")

Change = Publish | Reject | Forget

FOLDER_MODE = 0o750
"""Of the store's folder, where it has to be made."""

MAX_QUEUED = 64
"""Changes that wait for a disk that refuses writes; of more, the oldest rejected candidate is dropped."""


class Storage:
    """The store, locked for this process, and the state file. note: receives what is unusual, for the log."""

    def __init__(self, store: Store, note: Callable[[str], None]) -> None:
        self._store, self._note = store, note
        self._thread = Worker("disk")
        self._queued: deque[Change] = deque()
        self._trouble = ""
        self.document = StoreDocument()

    @property
    def path(self) -> Path:
        """The store's path."""
        return self._store.path

    @property
    def trouble(self) -> str:
        """Why the last write failed; empty where it did not."""
        return self._trouble

    @property
    def unsaved(self) -> Publish | Forget | None:
        """The newest change of the current calibration that is not on the disk; None where there is none."""
        return next((action for action in reversed(self._queued) if not isinstance(action, Reject)), None)

    def open(self) -> saved_state.Loaded:
        """Become the store's only writer, make it usable, and return the saved state.

        Blocks; for use before the loop runs. Raises StoreError.
        """
        path = self._store.path
        try:
            make_folder(path.parent, FOLDER_MODE)
        except OSError as error:
            raise store_error(error, path.parent, "make") from error
        try:
            self._store.lock()
        except StoreLockedError as error:  # a command may hold it for a moment
            raise StoreBusyError(str(error)) from error
        self._take_outcome(self._store.recover())
        state = saved_state.state_path(path)
        try:
            return saved_state.load(state)
        except OSError as error:
            raise store_error(error, state, "read") from error

    def enqueue(self, action: Change) -> None:
        """Take a calibration that was accepted, rejected or given up; `flush` writes it."""
        self._queued.append(action)

    async def flush(self) -> bool:
        """Write what waits, in order; say whether all of it is on the disk. For one task only."""
        while self._queued:
            action = self._queued[0]
            try:
                self._take_outcome(await self._run(self._write, action, self.document))
            except (StoreError, OSError, MemoryError) as error:
                self._note_failure(str(error) or "out of memory")
                self._drop_excess()
                return False
            except (ValueError, TypeError) as error:
                self._note(f"a calibration cannot be written and is left out: {error}")
            self._queued.popleft()
        return True

    async def save(self, data: bytes) -> bool:
        """Write the state file, unless the store waits for its turn; say whether it is on the disk."""
        if not await self.flush():
            return False
        try:
            await self._run(self._save, data, self.document)
        except (StoreError, OSError, MemoryError) as error:
            self._note_failure(str(error) or "out of memory")
            return False
        if self._trouble:
            self._note(f"{self._store.path} and its state are written again")
        self._trouble = ""
        return True

    def configure(self, settings: StoreSettings) -> None:
        """Take other settings; the path stays."""
        self._store.settings = settings

    async def rollback(self, target: int | str) -> StoreDocument:
        """Make an earlier calibration current. Raises ValueError where there is none such."""
        self._take_outcome(await self._run(self._rollback, target, self.document))
        return self.document

    def paths(self) -> set[Path]:
        """Return every file that is the store's or its state's."""
        path = self._store.path
        own = {path, self._store.last_good_path, saved_state.state_path(path)}
        return {*own, *(p.with_name(p.name + suffix) for p in own for suffix in (".tmp", ".lock"))}

    async def check(self) -> bool:
        """Hold on to lock and store, also where somebody has removed them; say whether that could be done."""
        try:
            await self._run(self._hold, self.document)
        except StoreError as error:
            self._note_failure(str(error))
            return False
        return True

    def close(self) -> None:
        """Finish the write in progress and unlock the store."""
        self._thread.close()
        self._store.close()

    def _hold(self, document: StoreDocument) -> None:
        """Take a removed lock anew, and write a removed or damaged store again. Raises StoreError."""
        for note in self._store.hold(document):
            self._note(note)

    def _write(self, action: Change, document: StoreDocument) -> Outcome:
        self._hold(document)
        if isinstance(action, Reject):
            return self._store.reject(action.record, action.reason, action.t)
        if isinstance(action, Forget):
            return self._store.retire(action.reason, action.t)
        return self._store.publish(action.record, action.reason, action.t)

    def _rollback(self, target: int | str, document: StoreDocument) -> Outcome:
        self._hold(document)
        return self._store.rollback(target)

    def _save(self, data: bytes, document: StoreDocument) -> None:
        self._hold(document)
        state = saved_state.state_path(self._store.path)
        try:
            saved_state.save(state, data)
        except OSError as error:
            raise store_error(error, state, "write") from error
        memory.release_free_pages()

    def _take_outcome(self, outcome: Outcome) -> None:
        self.document = outcome.document
        for note in outcome.notes:
            self._note(note)

    def _note_failure(self, trouble: str) -> None:
        if trouble != self._trouble:
            self._note(f"{trouble}; trying again")
        self._trouble = trouble

    def _drop_excess(self) -> None:
        while len(self._queued) > MAX_QUEUED:
            rejected = next((a for a in self._queued if isinstance(a, Reject)), self._queued[0])
            self._queued.remove(rejected)

    async def _run(self, job: Callable[..., T], *arguments: object) -> T:
        return await self._thread.run(job, *arguments)


def with_provenance(action: Change, source: str, device: str) -> Change:
    """Return the action with where its calibration comes from; one that is given up keeps its own."""
    if isinstance(action, Forget):
        return action
    provenance = replace(action.record.provenance, source=source, device=device)
    return replace(action, record=replace(action.record, provenance=provenance))
