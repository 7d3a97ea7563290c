"""Mutation testing: small changes of given functions, and whether the tests that call these notice."""
