"""Tests of the views of a log."""
