"""Synthetic people: hands, how they move, and what a device sees of them."""
