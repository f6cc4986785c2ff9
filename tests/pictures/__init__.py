"""Tests of the pictures drawn."""
