"""Integrity rules, one a file, in folders by what they look at; `mirror.dataset.check.registry` finds them all."""
