"""Goal expansion: fitted value iteration and its one-epoch look-ahead."""
