"""What the tests of the store share."""

from __future__ import annotations

import pytest

from tests.support.store_documents import published


@pytest.fixture
def document(make_record):
    return published(make_record(1), make_record(2))
