"""The page's server: access control, and checks of the messages that pages send."""
