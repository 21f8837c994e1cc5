"""Accuracy of the tiny PETR over processor time of training, on scenes and drives that it has not seen."""
