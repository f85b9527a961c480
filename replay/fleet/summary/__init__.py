"""A fleet described from its results: changes, spread, outliers, clusters, as tables, JSON and a page."""
