"""The YAML as typed, frozen settings. Knows nothing of DBC files, sockets or tracks."""

from candaemon.config.load import LoadedConfig, json_schema, load_config
from candaemon.config.settings import Config

__all__ = ["Config", "LoadedConfig", "json_schema", "load_config"]
