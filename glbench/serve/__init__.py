"""A task over HTTP: programs in any language act in seasons of its training or validation split (docs/serve.md).

``sessions`` has the seasons and knows no HTTP, ``messages`` what goes over the line, ``app`` the application (FastAPI) and its protection.
"""
