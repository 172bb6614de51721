"""The code that service and workers share: settings, records, store and queue. It uses neither HTTP nor torch."""
