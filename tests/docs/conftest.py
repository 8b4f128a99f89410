"""Fixtures for the tests of the pages."""

from tests.env.conftest import own_words as own_words
