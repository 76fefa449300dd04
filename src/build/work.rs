//! The folder in which a conversion keeps what does not fit memory, and what it needs to go on
//! after it was killed.
//!
//! The folder has a name that follows from the output's, so the next run finds it: a run of the
//! same inputs and options goes on from the last checkpoint, any other removes it. It is made when
//! something has to be written and removed at the end. A lock tells a dead run from a live one.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::build::BuildError;
use crate::store::lock_at_once;

/// Called before every write to disk; its error is the write's. For tests of full and failing
/// disks.
pub type BeforeWrite = Arc<dyn Fn() -> io::Result<()> + Send + Sync>;

/// The work folder of one output.
pub struct Work {
    folder: PathBuf,
    /// Held as long as the folder is in use.
    lock: Mutex<Option<File>>,
    before_write: Option<BeforeWrite>,
}

const LOCK: &str = "lock";
const STATE: &str = "state.json";
const NEW_STATE: &str = "state.new";

impl Work {
    /// The work of `output` in `temp_dir`. Whatever a dead run left stays for
    /// [`state`](Self::state) to judge.
    pub fn new(temp_dir: &Path, output: &Path, before_write: Option<BeforeWrite>) -> Self {
        let name = output.file_name().unwrap_or_default().to_string_lossy();
        let parent = output.parent().filter(|folder| !folder.as_os_str().is_empty());
        let place = if parent.unwrap_or(Path::new(".")) == temp_dir {
            String::new()
        } else {
            // Outputs of one name in several folders may share a folder of temporary files.
            let whole = std::path::absolute(output).unwrap_or_else(|_| output.into());
            format!("-{:08x}", crc32c::crc32c(whole.as_os_str().as_encoded_bytes()))
        };
        let folder = temp_dir.join(format!(".{name}{place}.work"));
        Work { folder, lock: Mutex::new(None), before_write }
    }

    /// The state that a dead run of the same job left; anything else that is there is removed.
    pub fn state<T: DeserializeOwned>(&self, job: &str) -> Result<Option<T>, BuildError> {
        if !self.folder.exists() {
            return Ok(None);
        }
        self.enter().map_err(|e| self.error("cannot use the work folder", e))?;
        let read = || -> Option<T> {
            let text = fs::read_to_string(self.folder.join(STATE)).ok()?;
            let (head, state) = text.split_once('\n')?;
            (head == job).then_some(())?;
            serde_json::from_str(state).ok()
        };
        let state = read();
        if state.is_none() {
            self.remove();
        }
        Ok(state)
    }

    /// Makes the folder if it is not there, and holds it.
    fn enter(&self) -> io::Result<()> {
        let mut lock = self.lock.lock().expect("no holder of the lock panics");
        if lock.is_none() {
            fs::create_dir_all(&self.folder)?;
            let path = self.folder.join(LOCK);
            let file = OpenOptions::new().create(true).truncate(false).write(true).open(path)?;
            lock_at_once(&file)?;
            *lock = Some(file);
        }
        Ok(())
    }

    /// A file in the folder, made if it is not there, kept if it is.
    pub fn file(&self, name: &str) -> io::Result<File> {
        self.enter()?;
        let path = self.folder.join(name);
        OpenOptions::new().create(true).truncate(false).read(true).write(true).open(path)
    }

    /// To be called before every write.
    pub fn before_write(&self) -> io::Result<()> {
        self.before_write.as_ref().map_or(Ok(()), |hook| hook())
    }

    /// Replaces the state of a job, at once or not at all. Files that it speaks of must be on disk.
    pub fn save_state<T: Serialize>(&self, job: &str, state: &T) -> Result<(), BuildError> {
        let save = || -> io::Result<()> {
            self.enter()?;
            self.before_write()?;
            let path = self.folder.join(NEW_STATE);
            let mut file = io::BufWriter::new(File::create(&path)?);
            file.write_all(job.as_bytes())?;
            file.write_all(b"\n")?;
            serde_json::to_writer(&mut file, state)?;
            let file = file.into_inner().map_err(|error| error.into_error())?;
            file.sync_all()?;
            self.before_write()?;
            fs::rename(&path, self.folder.join(STATE))?;
            // The new name, too; not every system can sync a folder.
            let _ = File::open(&self.folder).and_then(|folder| folder.sync_all());
            Ok(())
        };
        save().map_err(|e| self.error("cannot save how far the conversion is", e))
    }

    /// Where it is.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Whether there is something to go on from.
    pub fn has_state(&self) -> bool {
        self.folder.join(STATE).exists()
    }

    /// Removes the folder. What cannot be removed is in no one's way.
    pub fn remove(&self) {
        let mut lock = self.lock.lock().expect("no holder of the lock panics");
        if lock.take().is_some() {
            let _ = fs::remove_dir_all(&self.folder);
        }
    }

    /// Removes what a dead run left, whatever it was.
    pub fn discard(&self) {
        if self.folder.exists() && self.enter().is_ok() {
            self.remove();
        }
    }

    /// An error of this folder.
    pub fn error(&self, action: &'static str, source: io::Error) -> BuildError {
        BuildError::Temporary { action, source, path: self.folder.clone() }
    }
}
