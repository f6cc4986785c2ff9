"""What every package shares: datatypes, geometry, semantics, configuration."""
