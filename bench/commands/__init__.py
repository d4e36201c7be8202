"""One module a verb; imported only when the verb is used, so that ``--help`` costs nothing."""
