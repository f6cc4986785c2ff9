import numpy as np
import pytest
from PIL import Image

from roadperc_stream.errors import ConfigError, DumpError
from roadperc_stream.formats.images import encode_indices
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14, CARLA_FROM_0_9_14
from roadperc_stream.tools.readers.pixel_files import load_pixels
from roadperc_stream.tools.readers.tag_files import choose_table, named_table, tag_encoding, tags_of
from tests.tools.dump_writer import TAGS, alpha, camera_pixels, jpeg, npy, png, red

NEW = CARLA_FROM_0_9_14


def colours(tags, table=NEW):
    """(H, W, 3) blue, green, red palette image."""
    return np.ascontiguousarray(np.array(table.colours, np.uint8)[tags][..., ::-1])


def indexed(path, tags, palette):
    path.write_bytes(encode_indices(tags, palette))
    return path


def grey_palette(path, tags):
    return indexed(path, tags, tuple((i, 1, i) for i in range(256)))


def csv(path, tags, fmt="%d"):
    np.savetxt(path, tags, delimiter=", ", fmt=fmt)
    return path


MAKERS = {
    "red, bgr": (lambda p: png(p, red(TAGS)), "raw in red"),
    "red, bgra": (lambda p: png(p, alpha(red(TAGS))), "raw in red"),
    "equal grey": (lambda p: png(p, np.dstack([TAGS] * 3)), "raw grey"),
    "single grey": (lambda p: png(p, TAGS), "raw numbers"),
    "indices": (lambda p: grey_palette(p, TAGS), "raw numbers"),
    "csv": (lambda p: csv(p, TAGS), "raw numbers"),
    "csv of floats": (lambda p: csv(p, TAGS, "%.18e"), "raw numbers"),
    "npy": (lambda p: npy(p, TAGS), "raw numbers"),
    "raw bgra npy": (lambda p: npy(p, alpha(red(TAGS))), "raw in red"),
    "palette, rgb": (lambda p: png(p, colours(TAGS)), "palette colours"),
    "palette, rgba": (lambda p: png(p, alpha(colours(TAGS))), "palette colours"),
    "indices and palette": (lambda p: indexed(p, TAGS, NEW.colours), "palette colours"),
}


@pytest.mark.parametrize("name", MAKERS)
def test_every_encoding_gives_the_known_tags(tmp_path, name):
    make, encoding = MAKERS[name]
    path = make(tmp_path / "0.png")
    found, seen = tag_encoding([path], None, allow_lossy=False)
    assert found == encoding
    assert seen == (() if encoding == "palette colours" else (0, 1, 2, 14))
    tags = tags_of(load_pixels(path), found, NEW, allow_lossy=False)
    assert tags.dtype == np.uint8
    np.testing.assert_array_equal(tags, TAGS)


def test_a_named_version_chooses_the_table():
    assert named_table("0.9.13") == (CARLA_BEFORE_0_9_14, "CARLA 0.9.13")
    assert named_table("0.9.15")[0] is NEW
    assert named_table("kitti-360")[1] == "kitti-360"
    assert named_table(None) is None
    for wrong in ("newest", "newest.toml"):
        with pytest.raises(ConfigError, match="newest"):
            named_table(wrong)


def test_ambiguous_numbers_are_an_error_that_names_the_option():
    with pytest.raises(DumpError) as fault:
        choose_table("raw in red", (1, 7), "seg")
    message = str(fault.value)
    assert "--carla" in message
    assert "1 building, 7 road" in message
    assert "1 road, 7 traffic_light" in message


def test_an_unknown_colour_is_named_with_its_count(tmp_path):
    pixels = colours(TAGS)
    pixels[0, :3] = (3, 2, 1)
    path = png(tmp_path / "9.png", pixels)
    with pytest.raises(DumpError, match=r"9\.png: colour \(1, 2, 3\) \(3 pixels\)"):
        tags_of(load_pixels(path), "palette colours", NEW, allow_lossy=False)
    tags = tags_of(load_pixels(path), "palette colours", NEW, allow_lossy=True)
    assert (tags[0, :3] == 0).all()
    np.testing.assert_array_equal(tags[1:], TAGS[1:])


def test_a_tag_outside_the_table_is_named(tmp_path):
    path = png(tmp_path / "9.png", red(np.array([[7, 29, 30]], np.uint8)))
    with pytest.raises(DumpError, match=r"9\.png: tag 29 is not in carla-from-0.9.14 \(0 to 28\); 2 pixels"):
        tags_of(load_pixels(path), "raw in red", NEW, allow_lossy=False)


def blocks(values):
    """Large even areas, as JPEG likes them."""
    return np.kron(values, np.ones((16, 16), np.uint8)).astype(np.uint8)


def test_jpeg_is_refused_with_the_reason(tmp_path):
    path = jpeg(tmp_path / "0.jpg", colours(blocks(np.array([[1, 2]]))))
    with pytest.raises(DumpError, match=r"0\.jpg: tags as JPEG.*compression.*--allow-lossy-tags"):
        tag_encoding([path], None, allow_lossy=False)
    with pytest.raises(DumpError, match="tags as JPEG"):
        tags_of(load_pixels(path), "palette colours", NEW, allow_lossy=False)


def test_lossy_palette_colours_take_the_nearest(tmp_path):
    tags = blocks(np.array([[1, 2, 11], [24, 14, 9]]))
    path = jpeg(tmp_path / "0.jpg", colours(tags))
    encoding, _ = tag_encoding([path], None, allow_lossy=True)
    assert encoding == "palette colours"
    found = tags_of(load_pixels(path), encoding, NEW, allow_lossy=True)
    inner = (slice(4, 12), slice(4, 12))
    for row in range(2):
        for column in range(3):
            block = found[16 * row : 16 * row + 16, 16 * column : 16 * column + 16]
            assert (block[inner] == tags[16 * row, 16 * column]).all()


@pytest.mark.parametrize(
    "make",
    [
        lambda p: csv(p, np.array([[1.5, 2.0]]), "%.3f"),
        lambda p: npy(p, np.array([[np.nan, 1.0]])),
        lambda p: npy(p, np.zeros((2, 2, 3))),
        lambda p: png(p, camera_pixels()),
    ],
    ids=["half tags", "nan", "three floats", "a photograph"],
)
def test_other_content_than_tags_is_refused(tmp_path, make):
    path = make(tmp_path / "3.png")
    with pytest.raises(DumpError, match=r"3\.png"):
        tags_of(load_pixels(path), tag_encoding([path], None, allow_lossy=False)[0], NEW, allow_lossy=False)


def test_a_file_with_another_encoding_is_named(tmp_path):
    path = png(tmp_path / "4.png", colours(TAGS))
    with pytest.raises(DumpError, match=r"4\.png: tags are encoded as palette colours, the files before as raw in red"):
        tags_of(load_pixels(path), "raw in red", NEW, allow_lossy=False)


def of_dataset(name, path):
    table, _ = named_table(name)
    encoding, _ = tag_encoding([path], table, allow_lossy=False)
    return tags_of(load_pixels(path), encoding, table, allow_lossy=False)


IDS = np.array([[7, 26, 24], [0, 33, 7]])


@pytest.mark.parametrize(
    ("name", "make", "expected"),
    [
        ("cityscapes", lambda p: png(p, IDS.astype(np.uint8)), IDS),
        ("cityscapes", lambda p: png(p, np.where(IDS > 23, IDS * 1000 + 12, IDS).astype(np.uint16)), IDS),
        ("cityscapes", lambda p: png(p, colours(IDS, named_table("cityscapes")[0])), np.where(IDS == 0, 3, IDS)),
        ("mapillary-vistas-2.0", lambda p: indexed(p, IDS.astype(np.uint8), ((128, 64, 128),) * 34), IDS),
        ("mapillary-vistas-2.0", lambda p: png(p, np.dstack([IDS.astype(np.uint8) + 90] * 3)), IDS + 90),
        ("bdd100k", lambda p: png(p, red(np.array([[0, 13, 255]], np.uint8))), [[0, 13, 255]]),
        ("bdd100k-instances", lambda p: png(p, np.array([[[0, 4, 3, 2], [1, 0, 1, 9]]], np.uint8)), [[3, 1]]),
        ("bdd100k-lanes", lambda p: png(p, np.array([[0, 6, 55, 255]], np.uint8)), [[0, 6, 55, 255]]),
    ],
    ids=["ids", "instance ids", "colours", "palette", "equal grey", "red", "bitmask", "lanes"],
)
def test_masks_of_datasets(tmp_path, name, make, expected):
    np.testing.assert_array_equal(of_dataset(name, make(tmp_path / "0.png")), expected)


def test_a_value_that_a_dataset_lacks_is_named(tmp_path):
    path = png(tmp_path / "9.png", np.array([[7, 19, 200]], np.uint8))
    with pytest.raises(DumpError, match=r"9\.png: tag 19 is not in bdd100k \(0 to 18, 255\); 2 pixels"):
        of_dataset("bdd100k", path)
    own = tmp_path / "own.toml"
    own.write_text("[tags]\nroad = 7\ncar = 19\n")
    with pytest.raises(DumpError, match=r"tag 200 is not in .*own\.toml \(7, 19\); 1 pixels"):
        of_dataset(str(own), path)


@pytest.mark.parametrize("table", [CARLA_BEFORE_0_9_14, CARLA_FROM_0_9_14], ids=lambda table: table.name)
def test_every_colour_of_a_table_is_looked_up(tmp_path, table):
    tags = np.arange(len(table.names), dtype=np.uint8)[None]
    found = tags_of(
        load_pixels(png(tmp_path / "0.png", colours(tags, table))), "palette colours", table, allow_lossy=False
    )
    assert [table.colours[t] for t in found[0]] == list(table.colours)


def test_a_black_frame_does_not_decide(tmp_path):
    black = png(tmp_path / "0.png", np.zeros((4, 4, 3), np.uint8))
    palette = png(tmp_path / "1.png", colours(TAGS))
    assert tag_encoding([black, palette], None, allow_lossy=False)[0] == "palette colours"
    assert not tags_of(load_pixels(black), "palette colours", NEW, allow_lossy=False).any()


def test_colours_and_high_numbers_tell_the_table():
    assert choose_table("palette colours", (), "seg")[0] is NEW
    assert choose_table("raw in red", (1, 24), "seg")[0] is NEW


def test_lossy_raw_tags_take_what_is_there(tmp_path):
    path = jpeg(tmp_path / "0.jpg", np.dstack([blocks(np.array([[1, 14], [24, 28]]))] * 3))
    encoding, _ = tag_encoding([path], None, allow_lossy=True)
    assert encoding in ("raw in red", "raw grey")
    found = tags_of(load_pixels(path), encoding, NEW, allow_lossy=True)
    assert found.max() <= 28
    assert abs(int(found[8, 24]) - 14) <= 2


def test_interlaced_and_small_palettes_are_read(tmp_path):
    image = Image.fromarray(np.array([[0, 1], [1, 0]], np.uint8), "L").convert("L")
    image.putpalette([0, 0, 0, 128, 64, 128])
    image.save(tmp_path / "0.png", bits=1)
    path = tmp_path / "0.png"
    assert tag_encoding([path], None, allow_lossy=False)[0] == "palette colours"
    np.testing.assert_array_equal(
        tags_of(load_pixels(path), "palette colours", NEW, allow_lossy=False), [[0, 1], [1, 0]]
    )


@pytest.mark.parametrize(
    ("file", "name", "expected"),
    [
        ("cityscapes/gtFine/frankfurt_000000_000294_gtFine_labelIds.png", "cityscapes", {"road", "car", "sidewalk"}),
        ("cityscapes/gtFine/frankfurt_000000_000294_gtFine_instanceIds.png", "cityscapes", {"road", "car", "sidewalk"}),
        ("cityscapes/gtFine/frankfurt_000000_000294_gtFine_labelTrainIds.png", "cityscapes-train-ids", {"road", "car"}),
        ("bdd100k/semseg_mask.png", "bdd100k", {"car", "unlabeled"}),
        (
            "bdd100k/lane_gts/fe189115-9981a740.png",
            "bdd100k-lanes",
            {"crosswalk", "sidewalk", "road_line", "unlabeled"},
        ),
        ("bdd100k/insseg_bitmask.png", "bdd100k-instances", {"car", "unlabeled"}),
    ],
)
def test_real_masks(data_dir, file, name, expected):
    path = data_dir / "label_masks" / file
    table, _ = named_table(name)
    assert expected <= {table.name_of(tag) for tag in np.unique(of_dataset(name, path))}


def test_ids_and_instance_ids_of_a_real_frame_are_the_same(data_dir):
    stem = data_dir / "label_masks/cityscapes/gtFine/frankfurt_000000_000294_gtFine_labelIds.png"
    both = [
        of_dataset("cityscapes", stem.with_name(stem.name.replace("label", kind))) for kind in ("label", "instance")
    ]
    np.testing.assert_array_equal(*both)
