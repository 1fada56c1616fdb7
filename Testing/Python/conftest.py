"""What several test files share: the demo's phantom and the real images beside the checkout."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

# Before numpy is loaded: its own and scipy's threads wait for each other on small matrices when cores are busy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@pytest.fixture(scope="session")
def pelvis():
    """The demo's MRI of a pelvis with its default settings; painting it takes some seconds."""
    from VICRegistrationLib.phantoms.pelvis import pelvis_phantom

    return pelvis_phantom()


@pytest.fixture(scope="session")
def shared_data():
    """Folder of real images, which are no part of the project."""
    folder = Path(__file__).resolve().parents[3] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("there is no folder ../shared/data of real images beside the project")
    return folder
