"""The generated pages docs/reliability.md and docs/errors.md are up to date."""

import pytest

from tests import errors_page
from tests.promises import PAGE, TABLE, marked, written


def test_the_page_has_every_promise_with_its_tests():
    page = PAGE.read_text("utf-8")
    assert page == written(page), "make pages writes it"
    assert {title for _, title, _ in TABLE.findall(page)} == {section for section, _, _ in marked()}
    assert "| promise |" not in TABLE.sub("", page)


@pytest.mark.commands
def test_the_page_of_errors_has_the_messages_as_printed():
    assert errors_page.PAGE.read_text("utf-8") == errors_page.page(), "make pages writes it"
