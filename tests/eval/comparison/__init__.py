"""Tests of the comparison's rooms."""
