//! Any number of rows in the memory of one page, each with a mark: whether a cell of the node that
//! they go to takes it.
//!
//! Full pages go to the store of pages, which keeps them in memory as long as there is room.

use crate::build::BuildError;
use crate::build::pages::{DiskPlace, Page, PageBuffer, PageStore};
use crate::build::rows::RowLayout;

/// Rows in the order in which they came.
#[derive(Debug, Default)]
pub struct PagedRows<'p> {
    pages: Vec<Page<'p>>,
    open: Option<PageBuffer<'p>>,
    used: usize,
    /// Bytes of a marked row; 0 as long as none has come.
    stride: usize,
    rows: u64,
}

/// Bytes of a row with its mark.
pub fn marked_stride(layout: RowLayout) -> usize {
    layout.stride() + 1
}

impl<'p> PagedRows<'p> {
    /// How many there are.
    pub fn len(&self) -> u64 {
        self.rows
    }

    /// Takes one more.
    pub fn push(
        &mut self,
        pages: &PageStore<'p>,
        row: &[u8],
        is_kept: bool,
    ) -> Result<(), BuildError> {
        let stride = row.len() + 1;
        self.make_room(pages, stride)?;
        let room = self.open.as_mut().expect("there is room").room();
        room[self.used..self.used + row.len()].copy_from_slice(row);
        room[self.used + row.len()] = u8::from(is_kept);
        self.used += stride;
        self.rows += 1;
        Ok(())
    }

    /// Takes many, with their marks.
    pub fn push_marked(
        &mut self,
        pages: &PageStore<'p>,
        marked: &[u8],
        stride: usize,
    ) -> Result<(), BuildError> {
        let mut rest = marked;
        while !rest.is_empty() {
            self.make_room(pages, stride)?;
            let room = self.open.as_mut().expect("there is room").room();
            let count = ((room.len() - self.used) / stride).min(rest.len() / stride);
            assert!(count > 0, "a page holds a row");
            let (now, later) = rest.split_at(count * stride);
            room[self.used..self.used + now.len()].copy_from_slice(now);
            self.used += now.len();
            self.rows += count as u64;
            rest = later;
        }
        Ok(())
    }

    /// Opens a page, if none is or the open one is full.
    fn make_room(&mut self, pages: &PageStore<'p>, stride: usize) -> Result<(), BuildError> {
        self.stride = stride;
        if self.open.is_some() && self.used + stride > pages.page_bytes() {
            let mut full = self.open.take().expect("it was seen");
            full.set_used(self.used, stride);
            let (full, next) = pages.keep(full)?;
            self.pages.push(full);
            (self.open, self.used) = (Some(next), 0);
        }
        self.open.get_or_insert_with(|| pages.buffer());
        Ok(())
    }

    /// Takes all of another.
    pub fn append(
        &mut self,
        pages: &PageStore<'p>,
        mut other: PagedRows<'p>,
    ) -> Result<(), BuildError> {
        other.close(pages)?;
        self.close(pages)?;
        self.pages.append(&mut other.pages);
        self.rows += other.rows;
        Ok(())
    }

    /// Puts the last page away. More rows begin another.
    pub fn close(&mut self, pages: &PageStore<'p>) -> Result<(), BuildError> {
        if let Some(mut last) = self.open.take() {
            last.set_used(self.used, self.stride);
            self.pages.push(pages.keep_last(last)?);
            self.used = 0;
        }
        Ok(())
    }

    /// Brings all rows to disk and tells where they are, and how many.
    pub fn state(&mut self, pages: &PageStore<'p>) -> Result<(Vec<DiskPlace>, u64), BuildError> {
        self.close(pages)?;
        let places = self.pages.iter_mut().map(|page| pages.to_disk(page));
        Ok((places.collect::<Result<_, _>>()?, self.rows))
    }

    /// The rows of a state.
    pub fn resume((places, rows): (Vec<DiskPlace>, u64)) -> Self {
        let pages = places.into_iter().map(Page::Disk).collect();
        PagedRows { pages, rows, ..PagedRows::default() }
    }

    /// Hands out the pages' bytes in order, marked rows one after the other; they stay.
    pub fn visit(
        &mut self,
        pages: &PageStore<'p>,
        visit: &mut dyn FnMut(&[u8]) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        self.close(pages)?;
        for page in &self.pages {
            pages.look(page, &mut *visit)?;
        }
        Ok(())
    }

    /// Gives all pages back.
    pub fn discard(self, pages: &PageStore<'p>) -> Result<(), BuildError> {
        for page in self.into_pages(pages)? {
            if let Page::Memory(buffer) = page {
                pages.give_back(buffer);
            }
        }
        Ok(())
    }

    /// The pages, all put away.
    pub fn into_pages(mut self, pages: &PageStore<'p>) -> Result<Vec<Page<'p>>, BuildError> {
        self.close(pages)?;
        Ok(self.pages)
    }
}
