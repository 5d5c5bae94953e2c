"""How all tests are run.

Properties are tried with the same examples every time, so that what fails here fails everywhere. Others are drawn with
`--hypothesis-profile explore`, to look for those that fail.
"""

from __future__ import annotations

import os
import shutil
import tempfile

import pytest
import stored
from hypothesis import HealthCheck, settings

# Whether an example passes must not depend on how fast the machine is, nor on what else it does.
settings.register_profile("explore", deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True)
settings.register_profile("same", settings.get_profile("explore"), derandomize=True)
settings.load_profile("same")

LONGEST = "test_scenarios.py"  # minutes some of them; begun with, so that no processor waits for another at the end


def pytest_configure(config: pytest.Config) -> None:
    """Makes the folder of `stored`, which processes that are started from here know of, too."""
    if not hasattr(config, "workerinput"):
        os.environ[stored.VARIABLE] = tempfile.mkdtemp(prefix="climber-")


def pytest_unconfigure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        shutil.rmtree(os.environ.pop(stored.VARIABLE))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.name != LONGEST)
