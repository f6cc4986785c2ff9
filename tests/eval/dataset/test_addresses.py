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


@pytest.fixture(scope="module")
def dataset(tmp_path_factory, store):
    """On the disk; s3://drives/all has the same."""
    dataset = small_dataset(tmp_path_factory.mktemp("drives") / "dataset")
    keys = {"aws_access_key_id": "key", "aws_secret_access_key": "secret", "region_name": "us-east-1"}
    client = boto3.client("s3", endpoint_url=store["AWS_ENDPOINT_URL"], **keys)
    client.create_bucket(Bucket="drives")
    for path in dataset.rglob("*.parquet"):
        client.upload_file(str(path), "drives", f"all/{path.relative_to(dataset).as_posix()}")
    return dataset


def of_dataset(command, address, store, *options):
    return run(command, address, *options, env=environment(**store), timeout=120)


def test_it_is_reported_as_in_a_folder(dataset, store):
    here, there = (of_dataset("roadperc-report", place, store) for place in (dataset, "s3://drives/all/"))
    assert (here.returncode, there.returncode, there.stderr) == (0, 0, "")
    assert there.stdout.replace("s3://drives/all", str(dataset)) == here.stdout
    nothing = of_dataset("roadperc-report", "s3://drives/none", store)
    assert nothing.returncode == 1
    assert nothing.stderr.startswith("error: s3://drives/none/metrics/date=*/*.parquet: its data cannot be read")
    assert len(nothing.stderr.splitlines()) == 1


def test_it_compares_as_in_a_folder(dataset, store):
    options = ("--config", "default", "--config", "lanes.hold_s=2")
    here, there = (of_dataset("roadperc-compare", place, store, *options) for place in (dataset, "s3://drives/all/"))
    assert "worse" in here.stdout
    assert (there.returncode, there.stdout, there.stderr) == (here.returncode, here.stdout, here.stderr)
    nothing = of_dataset("roadperc-compare", "s3://drives/none", store)
    wanted = "error: s3://drives/none: no tables in metrics/date=.../; pass the OUT_DIR of roadperc-batch\n"
    assert (nothing.returncode, nothing.stderr) == (1, wanted)
