"""The operator's page: what was heard, as a pure model (`heard`, `view`), and the page of it.

Nothing but `page`, `controls` and `serving` needs the extra `page`.
"""
