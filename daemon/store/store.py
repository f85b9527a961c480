"""The store: one JSON file that holds the current calibration, always written as a whole.

This module changes the store; files.py reads and locks its files, document.py defines their contents.

Every change writes two whole files, `NAME.last-good` first and then `NAME`, each by an atomic rename:
a crash at any moment leaves both whole, and a `NAME` that something else damaged later is replaced by
`NAME.last-good` without losing the newest calibration. A copy of an older generation would lose it, and
earlier calibrations are in the history anyway. A missing `NAME` means a fresh start, even where a
`NAME.last-good` exists: a user begins anew by removing the store.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.daemon.store.atomic import sync_folder, write_atomically
from stillcal.daemon.store.document import SCHEMA, StoreDocument, render
from stillcal.daemon.store.files import Reading, StoreError, is_locked_by, read, store_error, take_lock

MODES = (0o600, 0o640)


@dataclass(frozen=True, slots=True)
class StoreSettings:
    """The store's path, permissions and size.

    path: "" for store.json in the service's state folder. mode: permissions, 0600 or 0640. history:
    how many earlier and rejected calibrations are aside.
    """

    path: str = ""
    mode: int = 0o600
    history: int = 32

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise ValueError(f"mode = 0o{self.mode:o}: must be 0o600 or 0o640")
        if not 2 <= self.history <= 1000:
            raise ValueError(f"history = {self.history}: must be within 2..1000")


@dataclass(frozen=True, slots=True)
class Outcome:
    """The document after a change. notes: unusual events, one line each, for the log."""

    document: StoreDocument
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Verification:
    """The state of a store and its last good copy; `whole` where the store itself is intact."""

    store: Reading
    last_good: Reading

    @property
    def whole(self) -> bool:
        """Whether the store can be used as it is."""
        return self.store.document is not None


class Store:
    """A calibration store at `path`.

    Reading needs no lock. A change locks the store while it lasts; who means to be its only writer for
    longer, such as the daemon, uses `with` or `lock`.
    """

    def __init__(self, path: Path | str, settings: StoreSettings | None = None) -> None:
        try:
            self.path = Path(path).resolve()
        except RuntimeError as error:  # what Path raises for a loop of links
            raise StoreError(f"{path}: its links lead in a circle: give another path") from error
        if not self.path.name:
            raise StoreError(f"{path}: is a folder: give the path of a file")
        self.settings = settings or StoreSettings()
        self._lock: int | None = None
        self._left: tuple[tuple[int, int, int] | None, ...] = ()
        """By what `_signs` tells the files as this process left them."""

    @property
    def last_good_path(self) -> Path:
        """The last good copy, which replaces a damaged store."""
        return self.path.with_name(self.path.name + ".last-good")

    @property
    def _lock_path(self) -> Path:
        return self.path.with_name(self.path.name + ".lock")

    def __enter__(self) -> Store:
        self.lock()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def lock(self) -> None:
        """Become the store's only writer until `close`, and again where the lock was removed meanwhile.

        Raises StoreLockedError where somebody else is, and StoreError where no store can be at the path.
        """
        self._refuse_irregular()
        with self._explaining():
            if self._lock is not None and not is_locked_by(self._lock, self._lock_path):
                self.close()  # somebody has removed it: take it anew before somebody else does
        if self._lock is None:
            self._lock = take_lock(self._lock_path, self.path)

    def close(self) -> None:
        """Unlock the store."""
        if self._lock is not None:
            descriptor, self._lock = self._lock, None
            with suppress(OSError):  # it is free even so (close(2))
                os.close(descriptor)

    def hold(self, known: StoreDocument) -> tuple[str, ...]:
        """Stay the store's only writer, and undo what others have done to its files; return what to log.

        known: what this process last read or wrote, which is written again where the files hold nothing
        usable. Raises StoreError.
        """
        self.lock()
        return () if self._signs() == self._left else self.recover(known).notes

    def _signs(self) -> tuple[tuple[int, int, int] | None, ...]:
        """Return what changes whenever somebody writes to the store or its copy; None where one is gone."""
        with self._explaining():
            return tuple(_signs(path) for path in (self.path, self.last_good_path))

    def load(self) -> StoreDocument | None:
        """Return the document, from the last good copy where the store is damaged; None where there is none.

        Changes nothing. Raises StoreError where both the store and its last good copy are damaged.
        """
        verification = self.verify()
        if verification.store.problem is None:
            return verification.store.document
        if verification.last_good.document is None:
            if verification.store.foreign and verification.last_good.problem is None:
                raise StoreError(f"{self.path} is no store of calibrations: give the JSON file of one")
            raise StoreError(
                f"{self.path} cannot be used ({verification.store.problem}), and {self.last_good_path.name}"
                " holds no good copy: give the path of a store that stillcal wrote"
            )
        return verification.last_good.document

    def load_if_any(self) -> StoreDocument | None:
        """Return what `load` does, and None also where neither the store nor its last copy is good."""
        found = self.verify()
        return found.store.document or found.last_good.document

    def put_back(self, document: StoreDocument) -> Path | None:
        """Make `document`, which a person has approved, the store; return where the file it replaced is now.

        Raises StoreError.
        """
        with self._locked(), self._explaining():
            aside = self._set_aside(self.path, "replaced") if self.path.exists() else None
            self.save(document)
        return aside

    def verify(self) -> Verification:
        """Read the store and its last good copy, with what is wrong with them. Changes nothing.

        Raises StoreError where something else than a file lies at the store's path, or it cannot be read.
        """
        self._refuse_irregular()
        return Verification(read(self.path), read(self.last_good_path))

    def _refuse_irregular(self) -> None:
        """Raise StoreError where something else than a file lies at the store's path."""
        try:
            found = self.path.stat()
        except FileNotFoundError:
            return
        except OSError as error:
            raise store_error(error, self.path, "read") from error
        if not stat.S_ISREG(found.st_mode):
            raise StoreError(f"{self.path} cannot be a store: not a regular file: give another path")

    def recover(self, known: StoreDocument | None = None) -> Outcome:
        """Make the store usable: to be called before the first use, and called again before every change.

        A damaged file is set aside under a new name, never overwritten; the last good copy takes its place.
        A store of an earlier schema is migrated and its original kept. known: the store's contents, as far as
        this process knows, which are written where the files hold none. Raises StoreError, also where the
        file is of another program and neither a last good copy nor `known` shows that a store was there.
        """
        known = known or StoreDocument()
        with self._locked(), self._explaining():
            outcome = self._recovered(known)
            self._left = self._signs()
            return outcome

    def _recovered(self, known: StoreDocument) -> Outcome:
        """Make the store usable whatever lies at its names."""
        verification = self.verify()
        if verification.store.foreign and known.blank and not verification.last_good.there:
            raise StoreError(
                f"{self.path} is not a stillcal store ({verification.store.problem}): "
                "give another path, or move it away to begin anew"
            )
        if verification.last_good.regular:
            return self._with_regular(verification, known)
        aside = self._set_aside(self.last_good_path, "unreadable")
        self.last_good_path.unlink(missing_ok=True)  # a FIFO or a link, which has two names now
        note = f"{self.last_good_path} was {verification.last_good.problem}; set aside as {aside}"
        outcome = self._with_regular(self.verify(), known)
        return replace(outcome, notes=(note, *outcome.notes))

    def _with_regular(self, verification: Verification, known: StoreDocument) -> Outcome:
        """Make the store usable where only regular files lie at its names."""
        if verification.store.problem is not None:
            return self._replace_damaged(verification, known)
        if verification.store.document is None:
            return self._begun(known)
        if verification.store.schema != SCHEMA:
            return self._migrate(verification.store.document, verification.store.schema)
        return self._copied(verification.store.document, verification.last_good)

    def save(self, document: StoreDocument) -> None:
        """Replace the store's contents.

        Raises StoreError with the old store intact; where only the folder's sync failed, it says so, and
        the new store is in place until a power cut.
        """
        data = render(document)
        try:
            with self._locked():
                for path in (self.last_good_path, self.path):
                    write_atomically(path, data, self.settings.mode)
                self._left = self._signs()
        except OSError as error:
            raise store_error(error, self.path, "write") from error

    def publish(self, calibration: CalibrationRecord, reason: str = "", at: float | None = None) -> Outcome:
        """Make `calibration` the current one; the previous one goes into the history; reason and time (s)."""
        return self.change(lambda d: d.after_publishing(calibration, self.settings.history, reason, at))

    def reject(self, candidate: CalibrationRecord, reason: str, at: float | None = None) -> Outcome:
        """Put a rejected candidate into the history; reason and time (s)."""
        return self.change(lambda d: d.after_rejecting(candidate, reason, self.settings.history, at))

    def retire(self, reason: str, at: float | None = None) -> Outcome:
        """Leave no calibration current, as for another phone; reason and time (s)."""
        return self.change(lambda d: d.after_retiring(reason, self.settings.history, at))

    def rollback(self, target: int | str = 1) -> Outcome:
        """Make an earlier calibration current again: the target-th before, or the one of this id.

        Raises ValueError where there is no such calibration, and changes nothing then.
        """
        (self.load() or StoreDocument()).after_rollback(target, self.settings.history)
        return self.change(lambda d: d.after_rollback(target, self.settings.history))

    def change(self, change: Callable[[StoreDocument], StoreDocument]) -> Outcome:
        """Replace the contents by what `change` makes of them, in one write."""
        with self._locked():
            before = self.recover()
            after = change(before.document)
            self.save(after)
        return Outcome(after, before.notes)

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Hold the lock for the block, and on where it was held before."""
        if self._lock is not None:
            self.lock()
            yield
            return
        with self:
            yield

    @contextmanager
    def _explaining(self) -> Iterator[None]:
        """Turn what the system refuses in the block into a StoreError."""
        try:
            yield
        except OSError as error:
            raise store_error(error, self.path, "change") from error

    def _migrate(self, document: StoreDocument, schema: int | None) -> Outcome:
        aside = self._set_aside(self.path, f"schema-{schema}")
        self.save(document)
        note = f"{self.path}: migrated from schema {schema} to {SCHEMA}; original aside as {aside}"
        return Outcome(document, (note,))

    def _copied(self, document: StoreDocument, last_good: Reading) -> Outcome:
        """See that an intact store has a good copy; a disk that refuses one now is no reason to stop."""
        if last_good.document is not None:
            return Outcome(document)
        note = f"{self.last_good_path} was {last_good.problem or 'missing'}; written anew from the store"
        try:
            write_atomically(self.last_good_path, render(document), self.settings.mode)
        except OSError as error:
            note = str(store_error(error, self.last_good_path, "write"))
        return Outcome(document, (note,))

    def _begun(self, known: StoreDocument) -> Outcome:
        """Begin a store, or write again what was there before somebody removed it."""
        if known.blank:
            return Outcome(known)
        self.save(known)
        return Outcome(known, (f"{self.path} was removed while it is in use: written again",))

    def _replace_damaged(self, verification: Verification, known: StoreDocument) -> Outcome:
        aside = self._set_aside(self.path, "unreadable")
        damage = f"{self.path} was {verification.store.problem}; set aside as {aside}"
        if verification.last_good.document is not None:
            self.save(verification.last_good.document)
            return Outcome(verification.last_good.document, (f"{damage}; its last good copy replaces it",))
        copy = "there is no good copy"
        if verification.last_good.problem is not None:
            aside = self._set_aside(self.last_good_path, "unreadable")
            copy = f"{self.last_good_path.name} was {verification.last_good.problem}; set aside as {aside}"
        if known.blank:
            self._remove_damaged()
            return Outcome(known, (f"{damage}; {copy}: starting without a calibration",))
        self.save(known)
        return Outcome(known, (f"{damage}; {copy}: it is written again as it was",))

    def _remove_damaged(self) -> None:
        """Remove the damaged names, which `_set_aside` has kept under others."""
        for path in (self.path, self.last_good_path):
            path.unlink(missing_ok=True)
        sync_folder(self.path.parent)

    def _set_aside(self, path: Path, label: str) -> Path:
        """Give the file a second, unused name, so that replacing the first loses nothing.

        A hard link, which refuses an existing name and leaves no moment without a store; where the file
        system has none (vfat), a rename under the writer's lock.
        """
        for n in range(1, 10_000):
            aside = path.with_name(f"{self.path.name}.{label}-{n}.json")
            if os.path.lexists(aside):
                continue
            try:
                os.link(path, aside, follow_symlinks=os.link not in os.supports_follow_symlinks)
            except FileExistsError:
                continue
            except OSError as error:
                if error.errno not in (errno.EPERM, errno.ENOTSUP):
                    raise store_error(error, path, "set aside") from error
                path.rename(aside)
            sync_folder(path.parent)
            return aside
        raise StoreError(
            f"{path.parent} has 9,999 files set aside ({label}-…): remove those that are not needed"
        )


def _signs(path: Path) -> tuple[int, int, int] | None:
    """Return what changes whenever a file is written to; None where there is none."""
    try:
        found = path.lstat()
    except FileNotFoundError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size
