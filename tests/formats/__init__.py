"""Tests of how pixels and points are stored."""
