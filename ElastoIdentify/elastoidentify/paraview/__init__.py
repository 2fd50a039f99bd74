"""ElastoIdentify in ParaView: the plugin, its launcher, and what they need."""
