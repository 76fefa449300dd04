//! How much may be read ahead and held in main memory.

use std::time::Duration;

/// Whether nodes come through the loader.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StreamWhen {
    /// If the scene is larger than the room for what is drawn.
    #[default]
    Auto,
    /// For every scene; to measure what it costs a small one.
    Always,
    /// Never: frames read themselves; to measure what the loader saves.
    Never,
}

/// How nodes come through the loader.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamSettings {
    /// Whether they do at all. Default: if the scene is larger than the room for it.
    pub when: StreamWhen,
    /// Most main memory for nodes, bytes: those that wait, those under way, and those kept for
    /// their return. Default 1 GiB. A larger value saves reading twice; a smaller one is read more
    /// often. A single node that is larger is loaded alone.
    pub memory_bytes: u64,
    /// Most nodes being read and unpacked at once, and threads that do it. Default 8: enough to
    /// keep a disk busy or to hide the delay of a distant store, and little that was in vain when
    /// the view changes. 0 starts no thread, and the owner turns the crank
    /// ([`Loader::work`](crate::stream::Loader::work)), for tests.
    pub in_flight_nodes: u32,
    /// Most stored bytes being read at once. Default 32 MiB.
    pub in_flight_bytes: u64,
    /// Most nodes being unpacked at once. Default: the cores of the machine.
    pub unpacking_nodes: u32,
    /// How far the motion of the camera is followed to read what will be seen. Default 0.25 s;
    /// zero reads nothing ahead.
    pub look_ahead: Duration,
    /// Time from frame to frame that motion is judged by; `None` (default) takes the clock's. For
    /// scripted cameras that shall repeat.
    pub frame_time: Option<Duration>,
}

impl Default for StreamSettings {
    fn default() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        StreamSettings {
            when: StreamWhen::Auto,
            memory_bytes: 1 << 30,
            in_flight_nodes: 8,
            in_flight_bytes: 32 << 20,
            unpacking_nodes: cores.min(64) as u32,
            look_ahead: Duration::from_millis(250),
            frame_time: None,
        }
    }
}
