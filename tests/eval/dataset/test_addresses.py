"""A dataset in an object store gives the same output as in a folder."""

import shlex

import boto3
import pytest
from moto.server import ThreadedMotoServer

from roadperc_stream.cli import compare, report
from tests.eval.dataset.datasets import small_dataset
from tests.eval.tables import outcome

NONE = "error: s3://drives/none: no tables in metrics/date=.../; pass the OUT_DIR of roadperc-batch\n"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """A dataset on the disk; a copy is at s3://drives/all."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    endpoint = f"http://{host}:{port}"
    dataset = small_dataset(tmp_path_factory.mktemp("drives") / "dataset")
    keys = {"aws_access_key_id": "key", "aws_secret_access_key": "secret", "region_name": "us-east-1"}
    client = boto3.client("s3", endpoint_url=endpoint, **keys)
    client.create_bucket(Bucket="drives")
    for path in dataset.rglob("*.parquet"):
        client.upload_file(str(path), "drives", f"all/{path.relative_to(dataset).as_posix()}")
    with pytest.MonkeyPatch.context() as variables:
        known = {"ACCESS_KEY_ID": "key", "SECRET_ACCESS_KEY": "secret", "REGION": "us-east-1"}
        for name, value in {**known, "ENDPOINT_URL": endpoint, "ALLOW_HTTP": "true"}.items():
            variables.setenv(f"AWS_{name}", value)
        yield dataset
    server.stop()


def test_the_report_is_the_same_as_for_a_folder(dataset, capsys):
    expected = outcome(report.main, capsys, dataset)[1]
    expected = expected.replace(shlex.quote(str(dataset)), "s3://drives/all").replace(str(dataset), "s3://drives/all")
    assert outcome(report.main, capsys, "s3://drives/all/") == (0, expected, "")
    assert outcome(report.main, capsys, "s3://drives/none") == (1, "", NONE)


def test_the_comparison_is_the_same_as_for_a_folder(dataset, capsys):
    options = ("--base-config", "default", "--new-config", "lanes.hold_s=2")
    code, text, error = outcome(compare.main, capsys, dataset, *options)
    assert "worse" in text
    expected = (code, text.replace(shlex.quote(str(dataset)), "s3://drives/all"), error)
    assert outcome(compare.main, capsys, "s3://drives/all", *options) == expected
    assert outcome(compare.main, capsys, "s3://drives/none") == (3, "", NONE)
