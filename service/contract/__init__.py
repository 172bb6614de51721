"""What the service and the workers share: settings, records, the store, the queue. Nothing here knows HTTP or torch."""
