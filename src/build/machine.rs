//! What the machine has: memory that a process may use, room on a disk.

use std::fs;
use std::path::{Path, PathBuf};

/// Memory of the machine or of the control groups that this process is in, whichever is least.
/// 4 GiB where none can be read.
pub fn available_memory() -> u64 {
    memory_under(Path::new("/"))
}

fn memory_under(root: &Path) -> u64 {
    let read = |path: PathBuf| fs::read_to_string(path).ok();
    let machine = read(root.join("proc/meminfo")).and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("MemTotal:"))?;
        line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib << 10)
    });
    let groups = read(root.join("proc/self/cgroup")).unwrap_or_default();
    let limits = groups.lines().filter_map(|line| group_limit(root, line));
    machine.into_iter().chain(limits).min().unwrap_or(4 << 30)
}

/// The least limit of a control group and those around it; `line` is `number:controllers:path`.
fn group_limit(root: &Path, line: &str) -> Option<u64> {
    let mut fields = line.splitn(3, ':').skip(1);
    let (controllers, group) = (fields.next()?, fields.next()?);
    // Version 2 has one hierarchy and names no controller.
    let (top, file) = if controllers.is_empty() {
        ("sys/fs/cgroup", "memory.max")
    } else if controllers.split(',').any(|controller| controller == "memory") {
        ("sys/fs/cgroup/memory", "memory.limit_in_bytes")
    } else {
        return None;
    };
    let group = Path::new(group.trim_start_matches('/'));
    // In a container the path may be the host's; then only the top is there.
    let folders = group.ancestors().map(|folder| root.join(top).join(folder));
    let limit =
        |folder: PathBuf| fs::read_to_string(folder.join(file)).ok()?.trim().parse::<u64>().ok();
    folders.filter_map(limit).min()
}

/// Room for this user on the disk that holds a folder; none where the system does not tell.
pub fn free_disk(folder: &Path) -> Option<u64> {
    fs4::available_space(folder).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn machine(files: &[(&str, &str)]) -> u64 {
        let root = tempfile::tempdir().expect("a temporary folder");
        for (name, text) in files {
            let path = root.path().join(name);
            fs::create_dir_all(path.parent().expect("it has one")).expect("it is made");
            fs::write(path, text).expect("it is written");
        }
        memory_under(root.path())
    }

    #[test]
    fn the_least_limit_counts() {
        let memory = ("proc/meminfo", "MemFree: 1 kB\nMemTotal:  2000 kB\n");
        assert_eq!(machine(&[]), 4 << 30);
        assert_eq!(machine(&[memory]), 2000 << 10);
        let version_2 = ("proc/self/cgroup", "0::/user/job\n");
        let parent = ("sys/fs/cgroup/user/memory.max", "900000\n");
        let own = ("sys/fs/cgroup/user/job/memory.max", "max\n");
        assert_eq!(machine(&[memory, version_2, parent, own]), 900_000);
        let small = ("sys/fs/cgroup/user/job/memory.max", "5000");
        assert_eq!(machine(&[memory, version_2, parent, small]), 5000);
        let version_1 = ("proc/self/cgroup", "5:cpu:/a\n4:hugetlb,memory:/docker/x\n");
        let top = ("sys/fs/cgroup/memory/memory.limit_in_bytes", "70000");
        assert_eq!(machine(&[memory, version_1, top]), 70_000);
        let unlimited = ("sys/fs/cgroup/memory/memory.limit_in_bytes", "9223372036854771712");
        assert_eq!(machine(&[memory, version_1, unlimited]), 2000 << 10);
    }
}
