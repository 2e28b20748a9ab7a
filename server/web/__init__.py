"""Who may connect to the page's server, and what a page may send."""
