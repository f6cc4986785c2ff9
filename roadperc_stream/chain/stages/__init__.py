"""The stages of the chain: each a pure function, none knows another."""
