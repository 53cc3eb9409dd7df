"""Accuracy of centroids and attitudes of any origin: statistics of ACC18 term by term, ECSS metrics, budgets."""
