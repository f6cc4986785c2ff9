"""A dataset in an object store is reported as one in a folder is."""

import boto3
import pytest
from moto.server import ThreadedMotoServer

from tests.commands import environment, run
from tests.eval.dataset.datasets import small_dataset


@pytest.fixture(scope="module")
def store():
    """Variables of the environment with which a server of its own is reached."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    _, port = server.get_host_and_port()
    yield {
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
        "AWS_ALLOW_HTTP": "true",
    }
    server.stop()


def report(address, store, *options):
    return run("roadperc-report", address, *options, env=environment(**store), timeout=120)


def test_it_reads_as_in_a_folder(tmp_path, store):
    dataset = small_dataset(tmp_path / "dataset")
    keys = {"aws_access_key_id": "key", "aws_secret_access_key": "secret", "region_name": "us-east-1"}
    client = boto3.client("s3", endpoint_url=store["AWS_ENDPOINT_URL"], **keys)
    client.create_bucket(Bucket="drives")
    for path in dataset.rglob("*.parquet"):
        client.upload_file(str(path), "drives", f"all/{path.relative_to(dataset).as_posix()}")
    here, there = report(dataset, store), report("s3://drives/all/", store)
    assert (here.returncode, there.returncode, there.stderr) == (0, 0, "")
    assert there.stdout.replace("s3://drives/all", str(dataset)) == here.stdout
    nothing = report("s3://drives/none", store)
    assert nothing.returncode == 1
    assert nothing.stderr.startswith(
        "error: s3://drives/none/metrics/date=*/*.parquet: is not a table that can be read"
    )
    assert len(nothing.stderr.splitlines()) == 1
