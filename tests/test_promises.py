"""docs/reliability.md says what the tests' markers say, and nothing else."""

from tests.promises import PAGE, TABLE, marked, written


def test_the_page_has_every_promise_with_its_tests():
    page = PAGE.read_text("utf-8")
    assert page == written(page), "make pages writes it"
    assert {title for _, title, _ in TABLE.findall(page)} == {section for section, _, _ in marked()}
    assert "| promise |" not in TABLE.sub("", page)
    assert len({promise for _, promise, _ in marked()}) > 80
