"""Errors of stores are one line with address and reason."""

import socket
import subprocess
import sys
import time

import pytest

from roadperc_stream.batch.storage import location
from roadperc_stream.batch.storage.location import Location, find_files
from roadperc_stream.errors import StorageError


def errors_of(address, tmp_path):
    """The errors of finding, fetching, writing and listing in a broken store."""
    (tmp_path / "source").write_bytes(b"x")
    for action in (
        lambda: find_files(f"{address}/*.mcap"),
        lambda: find_files(f"{address}/a.mcap"),
        lambda: Location(f"{address}/a.mcap").fetch(tmp_path / "a.mcap"),
        lambda: Location(address).at("a").write(b"x"),
        lambda: Location(address).at("a").put(tmp_path / "source"),
        lambda: Location(address).files(""),
    ):
        with pytest.raises(StorageError) as caught:
            action()
        assert str(caught.value).startswith(address)
        assert "\n" not in str(caught.value)
        yield str(caught.value)


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch):
    monkeypatch.setattr("roadperc_stream.batch.storage.location.WAITS_S", ())


def test_a_missing_bucket(bucket, tmp_path):
    for text in errors_of(f"{bucket}-not", tmp_path):
        assert "no such bucket" in text or text.endswith("no such file")


def test_unknown_keys(bucket, s3_server, tmp_path):
    with s3_server.checking_credentials():
        for text in errors_of(bucket, tmp_path):
            assert "access denied" in text
            assert "no credentials" not in text


def test_no_keys_at_all(bucket, monkeypatch):
    """The error is AWS's: moto's server crashes if a request has no keys."""
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    with (
        pytest.raises(StorageError, match="access denied, and no credentials in the environment"),
        location._errors(bucket),
    ):
        raise OSError("AWS Error ACCESS_DENIED during HeadObject operation: No response body.")


@pytest.mark.parametrize(
    ("endpoint", "why"),
    [("http://127.0.0.1:9", "the store refuses the connection"), ("http://no-such.invalid", "name does not resolve")],
)
def test_an_unreachable_store_is_an_error_within_seconds(bucket, tmp_path, monkeypatch, endpoint, why):
    monkeypatch.setenv("AWS_ENDPOINT_URL", endpoint)
    begin_s = time.monotonic()
    with pytest.raises(StorageError, match=why):
        find_files(f"{bucket}/*.mcap")
    assert time.monotonic() - begin_s < 20


def test_a_store_that_does_not_answer(bucket, monkeypatch):
    monkeypatch.setattr(
        "roadperc_stream.batch.storage.stores.TIMEOUTS_S", {"connect_timeout": 0.5, "request_timeout": 0.5}
    )
    with socket.create_server(("127.0.0.1", 0)) as silent:
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{silent.getsockname()[1]}")
        begin_s = time.monotonic()
        with pytest.raises(StorageError, match="the store does not answer"):
            find_files(f"{bucket}/*.mcap")
        assert time.monotonic() - begin_s < 20


def test_an_invalid_endpoint(bucket, monkeypatch):
    monkeypatch.setenv("AWS_ENDPOINT_URL", "ftp://127.0.0.1")
    with pytest.raises(StorageError, match="ftp"):
        find_files(f"{bucket}/*.mcap")


def test_the_endpoint_for_this_service_comes_first(bucket, s3_server, monkeypatch):
    Location(bucket).at("a.mcap").write(b"")
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("AWS_ENDPOINT_URL_S3", s3_server.url)
    assert len(find_files(bucket)) == 1


def test_an_unknown_scheme():
    with pytest.raises(StorageError, match=r"nope://a: fsspec knows no scheme nope://"):
        find_files("nope://a")


def test_the_error_names_the_missing_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "adlfs", None)
    with pytest.raises(StorageError, match=r"abfs://c/a: needs fsspec's package for abfs:// \(adlfs .*pip install"):
        find_files("abfs://c/a")


@pytest.mark.parametrize("end", ["", "os._exit(0)"])
def test_a_process_that_used_a_store_and_forked_ends(bucket, end):
    code = f"""
import os, sys, warnings
from roadperc_stream.batch.storage.location import Location
warnings.simplefilter("ignore", DeprecationWarning)  # newer versions of Python warn of a fork with threads
place = Location({bucket!r})
place.at("a").write(b"1")
child = os.fork()
if child == 0:
    assert place.at("a").read() == b"1"
    {end or "pass"}
else:
    assert os.waitpid(child, 0)[1] == 0
    place.at("b").write(b"2")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert Location(bucket).at("b").read() == b"2"
