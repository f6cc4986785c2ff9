"""Cityscapes: images below splits and cities, each with its label ids."""

import numpy as np
import pytest

from roadperc_stream.cli.convert import main
from tests.tools.dump_writer import HEIGHT, WIDTH, camera_pixels, png
from tests.tools.test_conversion import convert, failure, payloads

STEMS = ("train/aachen/aachen_000000_000019", "train/aachen/aachen_000001_000019", "val/lindau/lindau_000000_000019")
ROAD, CAR = 7, 26


@pytest.fixture
def cityscapes(tmp_path):
    folder = tmp_path / "cs"
    for k, stem in enumerate(STEMS):
        png(folder / "leftImg8bit" / f"{stem}_leftImg8bit.png", camera_pixels(k))
        png(folder / "gtFine" / f"{stem}_gtFine_labelIds.png", np.full((HEIGHT, WIDTH), ROAD, np.uint8))
        png(folder / "gtFine" / f"{stem}_gtFine_instanceIds.png", np.full((HEIGHT, WIDTH), CAR * 1000, np.uint16))
    (folder / "gtFine" / f"{STEMS[2]}_gtFine_labelIds.png").unlink()
    return folder


def test_images_and_label_ids_of_all_cities_are_converted(cityscapes):
    found = payloads(convert(cityscapes, "--fov", "50"))
    assert [ns / 1e9 for ns, _, _ in found["image"]] == [0.0, 2.0, 4.0]
    assert [ns / 1e9 for ns, _, _ in found["segmentation"]] == [0.0, 2.0]
    tags = found["segmentation"][0][2]
    assert {tags.table.name_of(tag) for tag in np.unique(tags.tags)} == {"road"}


def test_one_city_is_chosen_and_a_missing_one_is_an_error(cityscapes, tmp_path, capsys):
    options = ("--fov", "50", "--tags", "cityscapes", "--force")
    found = payloads(convert(cityscapes, *options, "--sequence", "val/lindau"))
    assert len(found["image"]) == 1
    assert "leftImg8bit/test" in failure(capsys, cityscapes, tmp_path / "o.mcap", *options, "--sequence", "test")


def test_a_real_frame_in_folders_without_splits(data_dir, tmp_path):
    out = tmp_path / "o.mcap"
    assert main([str(data_dir / "label_masks" / "cityscapes"), str(out), "--fov", "50", "--quiet"]) == 0
    tags = payloads(out)["segmentation"][0][2]
    assert {tags.table.name_of(tag) for tag in np.unique(tags.tags)} >= {"road", "car", "sidewalk"}
