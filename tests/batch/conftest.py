"""The three kinds of storage: this machine's disk, a real S3 server, and a store of fsspec."""

from uuid import uuid4

import pytest


@pytest.fixture(params=["disk", "s3", "fsspec"])
def place(request, tmp_path):
    """The address of a folder that does not exist yet."""
    if request.param == "s3":
        return f"{request.getfixturevalue('bucket')}/some folder/ö"
    return str(tmp_path / "folder") if request.param == "disk" else f"memory://{uuid4().hex}/folder"
